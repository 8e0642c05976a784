"""Features of pictures by their content: matched in pairs, and handed on to a reconstruction's database."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from oracle import blobs

from colmap_ihe.colmap import tried_features
from colmap_ihe.colmap.features import extract_features
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.colmap.tried_features import (
    TriedFeatures,
    add_pictures,
    content_of,
    match_pictures,
)
from colmap_ihe.dense.undistort import read_grey
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.project.options import CameraOptions, FeaturesOptions

HOMOGRAPHY = np.array([[0.96, 0.08, 12.0], [-0.06, 1.02, 9.0], [4e-5, -3e-5, 1.0]])
SIZE = (420, 320)
DEFAULT = FeaturesOptions()


def texture(seed: int) -> NDArray[np.uint8]:
    return np.asarray(np.clip(127 + 62 * blobs(seed, *SIZE), 0, 255), np.uint8)


def pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    first = texture(1)
    second: Any = cv2.warpPerspective(first, HOMOGRAPHY, SIZE, flags=cv2.INTER_CUBIC)
    return first, np.asarray(second, np.uint8)


def features(database: Path, name: str) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    with pycolmap.Database.open(database) as opened:
        (image_id,) = [i.image_id for i in opened.read_all_images() if i.name == name]
        return np.array(opened.read_keypoints(image_id)), np.array(opened.read_descriptors(image_id).data)


def test_verified_matches_lie_where_both_pictures_show_the_plane(tmp_path: Path) -> None:
    first, second = pair()
    with quiet():
        pictures = [("a", first), ("b", second), ("c", texture(7)), ("d", np.full(SIZE[::-1], 90, np.uint8))]
        ids = add_pictures(tmp_path / "tried.db", pictures, DEFAULT, SILENT)
        assert ids == [1, 2, 3, 4]
        pairs = [(1, 2), (1, 3), (1, 4)]
        found = match_pictures(tmp_path / "tried.db", pairs, tmp_path / "parts", SILENT)
    matches = found[1, 2]
    assert matches.features > matches.putative >= len(matches.places) > 0.2 * matches.features
    there = cv2.perspectiveTransform(matches.places[:, None], HOMOGRAPHY)[:, 0]
    assert np.mean((there > -2) & (there < np.array(SIZE) + 2)) > 0.99
    assert len(found[1, 3].places) == len(found[1, 4].places) == 0
    assert not (tmp_path / "parts").exists()


def test_a_name_tells_the_picture_and_the_options() -> None:
    first, second = pair()
    other = FeaturesOptions(max_image_size=210)
    names = {content_of(first, DEFAULT), content_of(second, DEFAULT), content_of(first, other)}
    assert len(names) == 3
    assert content_of(first.copy(), FeaturesOptions()) == content_of(first, DEFAULT)
    assert content_of(first.reshape(210, 640), DEFAULT) not in names


@pytest.fixture
def grey(tmp_path: Path) -> Path:
    (tmp_path / "grey").mkdir()
    for name, image in zip(("a.png", "b.png", "c.png"), (*pair(), texture(7)), strict=True):
        (tmp_path / "grey" / name).write_bytes(encode_png(image))
    return tmp_path / "grey"


def extracted(
    database: Path,
    grey: Path,
    tried: Path | None,
    masks: Path | None = None,
    options: FeaturesOptions = DEFAULT,
) -> None:
    captures = {f"{name}.png": f"{name}.jpg" for name in "abc"}
    known = TriedFeatures(tried, captures, lambda name: read_grey(grey / name)) if tried else None
    with quiet(), local_executor() as executor:
        extract_features(
            database,
            grey,
            sorted(captures),
            masks,
            CameraOptions(),
            options,
            database.parent / "scratch",
            executor,
            SILENT,
            tried=known,
        )


def marked(database: Path) -> None:
    """Leave of all features the first five, so that a copy can be told from what COLMAP finds."""
    with pycolmap.Database.open(database) as opened:
        images = {str(i.name): i.image_id for i in opened.read_all_images()}
        kept = {n: (opened.read_keypoints(i), opened.read_descriptors(i)) for n, i in images.items()}
        opened.clear_keypoints()
        opened.clear_descriptors()
        for name, image_id in images.items():
            points, descriptors = kept[name]
            opened.write_keypoints(image_id, np.array(points)[:5])
            few = pycolmap.FeatureDescriptors(descriptors.type, np.array(descriptors.data)[:5])
            opened.write_descriptors(image_id, few)


def test_what_was_tried_is_what_colmap_finds_again(tmp_path: Path, grey: Path) -> None:
    tried = tmp_path / "tried.db"
    with quiet():
        add_pictures(tried, [(f"{n}.jpg", read_grey(grey / f"{n}.png")) for n in "ab"], DEFAULT, SILENT)
    extracted(tmp_path / "whole.db", grey, None)
    extracted(tmp_path / "copied.db", grey, tried)
    for name in ("a.png", "b.png", "c.png"):
        points, descriptors = features(tmp_path / "whole.db", name)
        copied_points, copied_descriptors = features(tmp_path / "copied.db", name)
        assert np.array_equal(points, copied_points), name
        assert np.array_equal(descriptors, copied_descriptors), name


def test_only_the_very_picture_with_these_options_and_no_mask_is_copied(
    tmp_path: Path, grey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried, capped = tmp_path / "tried.db", FeaturesOptions(colmap={"sift": {"peak_threshold": 0.02}})
    pictures = [(f"{n}.jpg", read_grey(grey / f"{n}.png")) for n in "ab"]
    with quiet():
        add_pictures(tried, [*pictures, ("c.jpg", pair()[0])], capped, SILENT)  # c.jpg looked otherwise
    marked(tried)
    extracted(tmp_path / "copied.db", grey, tried, options=capped)
    assert counts(tmp_path / "copied.db")[:2] == [5, 5]
    assert counts(tmp_path / "copied.db")[2] > 300
    (masks := tmp_path / "masks").mkdir()
    for name in ("a.png", "b.png", "c.png"):
        (masks / f"{name}.png").write_bytes(encode_png(np.full(SIZE[::-1], 255, np.uint8)))
    extracted(tmp_path / "masked.db", grey, tried, masks, capped)
    extracted(tmp_path / "other.db", grey, tried, options=FeaturesOptions(max_image_size=400))
    assert min(counts(tmp_path / "masked.db") + counts(tmp_path / "other.db")) > 300
    monkeypatch.setattr(tried_features, "_on_gpu", lambda _options: True)
    extracted(tmp_path / "gpu.db", grey, tried, options=capped)
    assert min(counts(tmp_path / "gpu.db")) > 300


def counts(database: Path) -> list[int]:
    return [len(features(database, f"{name}.png")[0]) for name in "abc"]
