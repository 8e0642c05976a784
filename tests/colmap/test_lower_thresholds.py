"""Images that stay below the cap get weaker features; others, and thresholds that the user gives, stay as they are."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing, contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from same_results import known_of

from colmap_ihe.colmap import lower_thresholds
from colmap_ihe.colmap.features import FeatureCounts, extract_features
from colmap_ihe.errors import NativeError
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.project.options import CameraOptions, FeaturesOptions

NAMES = ["a.png", "b.png", "c.png"]
LOWEST = lower_thresholds.COLMAPS_THRESHOLD / 2 * (2**0.2 - 1) / (2 ** (1 / 3) - 1)
OWN: dict[str, Any] = {"peak_threshold": lower_thresholds.COLMAPS_THRESHOLD}


@pytest.fixture(scope="module")
def grey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write images of blobs whose contrast goes down from left to right."""
    folder = tmp_path_factory.mktemp("grey")
    for seed, name in enumerate(NAMES):
        noise = np.random.default_rng(seed).normal(size=(120, 200 + 40 * seed))
        blobs = cv2.GaussianBlur(noise, (0, 0), 2) * np.geomspace(150, 8, noise.shape[1])
        pixels = np.clip(128 + blobs, 0, 255).astype(np.uint8)
        (folder / name).write_bytes(encode_image(pixels, b"", "png"))
    return folder


@contextmanager
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as executor:
        yield executor


def extracted(
    root: Path, grey: Path, executor: Executor, masks: Path | None = None, **sift: float
) -> FeatureCounts:
    root.mkdir(exist_ok=True)
    options = FeaturesOptions.model_validate({"colmap": {"sift": sift}})
    return extract_features(
        root / "database.db", grey, NAMES, masks, CameraOptions(), options, root, executor, SILENT
    )


def run(
    root: Path, grey: Path, masks: Path | None = None, **sift: float
) -> tuple[FeatureCounts, dict[str, Any]]:
    with threads() as executor:
        counts = extracted(root, grey, executor, masks, **sift)
    return counts, known_of(root / "database.db")


def places(known: dict[str, Any]) -> list[int]:
    """Return the different places with features of each image."""
    arrays = [np.frombuffer(data, np.float32).reshape(-1, 6) for data in known["keypoints"].values()]
    return [len(np.unique(array[:, :2], axis=0)) for array in arrays]


def test_images_below_the_cap_get_the_features_of_the_lowest_threshold(tmp_path: Path, grey: Path) -> None:
    counts, known = run(tmp_path / "auto", grey)
    own, _ = run(tmp_path / "own", grey, **OWN)
    lowest, expected = run(tmp_path / "low", grey, peak_threshold=LOWEST, octave_resolution=5)
    assert known == expected
    assert (counts.extracted_again, own.extracted_again, lowest.extracted_again) == (3, 0, 0)
    assert counts.features == lowest.features > 1.2 * own.features


def test_where_the_cap_binds_nothing_is_extracted_again(tmp_path: Path, grey: Path) -> None:
    counts, known = run(tmp_path / "auto", grey, max_num_features=20)
    assert counts.extracted_again == 0
    assert known == run(tmp_path / "own", grey, max_num_features=20, **OWN)[1]


def test_the_cap_is_that_of_five_scales_and_never_above_the_users_own() -> None:
    def cap(**sift: float) -> int:
        return lower_thresholds.cap_again(FeaturesOptions(colmap={"sift": sift}))

    assert cap() == round(1.4 * 8192)
    assert cap(octave_resolution=4) == 8192
    assert cap(max_num_features=3000) == 3000


def test_a_threshold_in_between_finds_more_and_keeps_to_the_cap(tmp_path: Path, grey: Path) -> None:
    first = places(run(tmp_path / "own", grey, **OWN)[1])
    lowest = places(run(tmp_path / "auto", grey)[1])
    cap = round(1.4 * first[2]) + 5
    counts, known = run(tmp_path / "capped", grey, max_num_features=cap)
    assert counts.extracted_again == 3
    assert first[2] < places(known)[2] <= cap < lowest[2]


def test_what_lies_under_a_mask_does_not_count(tmp_path: Path, grey: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    shown = np.zeros((120, 200), np.uint8)
    shown[:, 100:] = 255
    (masks / "a.png.png").write_bytes(encode_image(shown, b"", "png"))
    whole = places(run(tmp_path / "whole", grey, **OWN)[1])
    counts, known = run(tmp_path / "masked", grey, masks, max_num_features=min(whole) - 1)
    uncapped = run(tmp_path / "uncapped", grey, masks, peak_threshold=LOWEST, octave_resolution=5)[1]
    assert counts.extracted_again == 1
    assert known["keypoints"][1] == uncapped["keypoints"][1]
    assert places(known)[0] > 0.2 * whole[0]


def test_workers_elsewhere_give_the_same(tmp_path: Path, grey: Path) -> None:
    counts, known = run(tmp_path / "threads", grey)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes:
        assert extracted(tmp_path / "workers", grey, processes) == counts
    assert known_of(tmp_path / "workers/database.db") == known
    assert not (tmp_path / "workers/parts").exists()


@pytest.mark.parametrize("shards_done", [0, 1, 2])
def test_an_interruption_leaves_features_and_the_next_run_ends_the_same(
    tmp_path: Path, grey: Path, monkeypatch: pytest.MonkeyPatch, shards_done: int
) -> None:
    monkeypatch.setattr(lower_thresholds, "_IMAGES", 1)
    whole = run(tmp_path / "whole", grey)
    replace = lower_thresholds._replace_features
    done: list[Any] = []

    def stopping(*args: Any) -> None:
        if len(done) == shards_done:
            raise KeyboardInterrupt
        replace(*args)
        done.append(args)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(lower_thresholds, "_replace_features", stopping)
        run(tmp_path / "stopped", grey)
    database = tmp_path / "stopped/database.db"
    assert min(places(known_of(database))) > 20
    assert lower_thresholds.count_extracted_again(database) == shards_done
    assert run(tmp_path / "stopped", grey) == whole
    assert run(tmp_path / "stopped", grey) == whole


def test_keypoints_and_descriptors_are_replaced_together(tmp_path: Path, grey: Path) -> None:
    """Stop SQLite at the descriptors of the second image."""
    _, own = run(tmp_path, grey, **OWN)
    database = tmp_path / "database.db"
    with closing(sqlite3.connect(database)) as opened, opened:
        opened.execute(
            "CREATE TRIGGER full BEFORE UPDATE ON descriptors WHEN NEW.image_id = 2"
            " BEGIN SELECT RAISE(ABORT, 'disk is full'); END"
        )
    with pytest.raises(NativeError, match=r"database\.db: features could not be written: disk is full"):
        run(tmp_path, grey)
    assert known_of(database) == own
    assert lower_thresholds.count_extracted_again(database) == 0
    with closing(sqlite3.connect(database)) as opened, opened:
        opened.execute("DROP TRIGGER full")
    assert run(tmp_path, grey) == run(tmp_path / "whole", grey)


def test_scales_that_are_given_stay(tmp_path: Path, grey: Path) -> None:
    _, known = run(tmp_path / "auto", grey, octave_resolution=4)
    finer = {"peak_threshold": OWN["peak_threshold"] / 2, "octave_resolution": 4}
    assert known == run(tmp_path / "low", grey, **finer)[1]


def test_the_lowest_threshold_finds_all_that_the_first_does(tmp_path: Path, grey: Path) -> None:
    """With as many scales."""
    scales = {"octave_resolution": 3}
    low, own = (run(tmp_path / name, grey, **sift)[1] for name, sift in (("low", scales), ("own", OWN)))
    for image_id in own["images"]:
        assert rows_of(own, image_id) < rows_of(low, image_id)


def rows_of(known: dict[str, Any], image_id: int) -> set[tuple[bytes, bytes]]:
    """Return each keypoint of an image with its descriptor."""
    keypoints, descriptors = known["keypoints"][image_id], known["descriptors"][image_id]
    return {
        (keypoints[24 * n : 24 * n + 24], descriptors[128 * n : 128 * n + 128])
        for n in range(len(keypoints) // 24)
    }


@pytest.mark.parametrize(
    ("places", "most", "share"),
    [(7000, 9000, 24 / 32), (0, 16384, 25 / 32), (8191, 9000, 31 / 32)],
)
def test_the_threshold_in_between_is_where_a_straight_line_meets_the_cap(
    places: int, most: int, share: float
) -> None:
    assert lower_thresholds._share_for(8192, places, most) == share
