"""Large images are extracted without the doubled one where the cap leaves nothing of it, and as COLMAP's where not."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.colmap import coarse_first
from colmap_ihe.colmap.coarse_first import coarse_names, extract_coarse_first, places
from colmap_ihe.colmap.extraction import extraction_options
from colmap_ihe.colmap.features import extract_features
from colmap_ihe.colmap.features_on_workers import extract_in_shards
from colmap_ihe.colmap.image_import import ImageGroup, import_images
from colmap_ihe.colmap.known_calibration import KnownCalibration
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.colmap.tried_features import add_pictures
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.project.options import CameraOptions, FeaturesOptions

CAP = 150
NAMES = ["bare.png", "rich.png"]
AUTO, WHOLE = (
    FeaturesOptions.model_validate({"octaves": octaves, "colmap": {"sift": {"max_num_features": CAP}}})
    for octaves in ("auto", "colmap")
)


def texture(dots: int) -> NDArray[np.uint8]:
    """Return a grey image with so many round dots of 2 to 5 pixels."""
    draw = np.random.default_rng(dots)
    down, across = np.mgrid[:240, :320]
    image = np.full(down.shape, 90.0)
    for x, y, size, level in draw.uniform((0, 0, 1.5, -70), (320, 240, 4, 70), (dots, 4)):
        image += level * np.exp(-((across - x) ** 2 + (down - y) ** 2) / (2 * size**2))
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.fixture
def grey(tmp_path: Path) -> Path:
    (tmp_path / "grey").mkdir()
    for name, dots in zip(NAMES, (60, 900), strict=True):
        (tmp_path / "grey" / name).write_bytes(encode_image(texture(dots), b"", "png"))
    return tmp_path / "grey"


def extracted(database: Path, grey: Path, options: FeaturesOptions, masks: Path | None = None) -> None:
    with quiet(), ThreadPoolExecutor(1) as threads:
        extract_features(
            database, grey, NAMES, masks, CameraOptions(), options, database.parent, threads, SILENT
        )


def imported(database: Path, grey: Path) -> None:
    group = ImageGroup(NAMES, pycolmap.CameraMode.PER_IMAGE)
    reader = pycolmap.ImageReaderOptions()
    with quiet():
        import_images(database, grey, [group], reader, KnownCalibration([], {}), SILENT)


def known_of(database: Path) -> dict[str, NDArray[np.float32]]:
    """Return the keypoints of each image."""
    with pycolmap.Database.open(database) as opened:
        return {str(i.name): opened.read_keypoints(i.image_id) for i in opened.read_all_images()}


def same(first: Path, second: Path) -> bool:
    keypoints = known_of(first), known_of(second)
    return all(np.array_equal(keypoints[0][name], keypoints[1][name]) for name in NAMES)


def test_images_large_for_the_cap_are_tried_and_those_under_a_mask_are_not() -> None:
    extraction = extraction_options(FeaturesOptions())
    sizes = {
        "large": (2400, 1600),
        "small": (1600, 1067),
        "huge": (12000, 1000),
    }  # the last seen at 3200 x 267
    assert coarse_names(sizes, extraction) == ["large"]
    assert coarse_names(sizes, extraction, Path("masks")) == []
    extraction.sift.max_num_features = 2000
    assert coarse_names(sizes, extraction) == ["large", "small", "huge"]
    for name, value in {"first_octave": 0, "peak_threshold": 0.004, "domain_size_pooling": True}.items():
        given = extraction_options(FeaturesOptions(colmap={"sift": {name: value}}))
        assert coarse_names(sizes, given) == []


def test_above_the_cap_features_are_of_the_own_resolution_and_as_many_as_colmaps(
    tmp_path: Path, grey: Path
) -> None:
    extracted(tmp_path / "auto.db", grey, AUTO)
    extracted(tmp_path / "whole.db", grey, WHOLE)
    auto, whole = known_of(tmp_path / "auto.db"), known_of(tmp_path / "whole.db")
    assert np.hypot(auto["rich.png"][:, 2], auto["rich.png"][:, 4]).min() >= 1.59
    assert not np.array_equal(auto["rich.png"], whole["rich.png"])
    assert places(whole["rich.png"]) > CAP
    assert places(whole["rich.png"]) <= places(auto["rich.png"]) <= 1.05 * places(whole["rich.png"])
    near = [np.abs(auto["rich.png"][:, :2] - place).max(axis=1).min() for place in whole["rich.png"][:, :2]]
    assert np.mean(np.array(near) < 0.05) > 0.9
    assert np.array_equal(auto["bare.png"], whole["bare.png"])
    assert 0 < places(auto["bare.png"]) < CAP


def test_an_interrupted_run_is_taken_up_where_it_was(tmp_path: Path, grey: Path) -> None:
    database = tmp_path / "interrupted.db"
    imported(database, grey)
    first_octave = extraction_options(AUTO)
    first_octave.sift.first_octave = 0
    with quiet():
        extract_coarse_first(database, grey, NAMES[:1], [], first_octave, SILENT)
    short = known_of(database)["bare.png"]
    extracted(database, grey, AUTO)
    extracted(tmp_path / "at-once.db", grey, AUTO)
    assert len(short) < len(known_of(database)["bare.png"])
    assert same(database, tmp_path / "at-once.db")


def test_workers_and_trials_find_the_same(tmp_path: Path, grey: Path) -> None:
    capped = AUTO.model_copy(
        update={"colmap": {"sift": {"max_num_features": 40}}}
    )  # both images are above it
    extracted(tmp_path / "here.db", grey, capped)
    imported(tmp_path / "there.db", grey)
    parts = tmp_path / "parts"
    with quiet(), ThreadPoolExecutor(1) as threads:
        extract_in_shards(tmp_path / "there.db", grey, None, capped, NAMES, parts, threads, SILENT)
    assert same(tmp_path / "here.db", tmp_path / "there.db")
    with quiet():
        add_pictures(tmp_path / "tried.db", [("rich", texture(900))], capped, SILENT)
    (tried,) = known_of(tmp_path / "tried.db").values()
    assert np.array_equal(tried, known_of(tmp_path / "here.db")["rich.png"])


def test_more_images_than_are_copied_at_once(
    tmp_path: Path, grey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = AUTO.model_copy(update={"colmap": {"sift": {"max_num_features": 40}, "num_threads": 1}})
    extracted(tmp_path / "at-once.db", grey, options)
    monkeypatch.setattr(coarse_first, "_AT_ONCE", 1)
    extracted(tmp_path / "one-by-one.db", grey, options)
    assert same(tmp_path / "at-once.db", tmp_path / "one-by-one.db")
