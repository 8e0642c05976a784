"""Coded targets in pictures: which are found, and how near to the true centre."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest
from target_scenes import Sight, TargetPicture, target_picture

from colmap_ihe.errors import OptionError
from colmap_ihe.survey.targets import Target, dictionary_of, find_targets, target_name


def pictures(sight: Sight, count: int = 12) -> list[TargetPicture]:
    rng = np.random.default_rng(4)
    return [target_picture(sight, rng) for _ in range(count)]


def errors(sight: Sight, count: int = 12) -> tuple[np.ndarray, list[Target]]:
    """(N, 2) of centres, all of which have to be found under the right names."""
    off, targets = [], []
    for picture in pictures(sight, count):
        found = find_targets(picture.grey)
        assert [target.name for target in found] == [target_name(picture.number)]
        np.testing.assert_allclose(found[0].corners_px, picture.corners_px, atol=1.2)
        off.append(np.subtract(found[0].centre_px, picture.centre_px))
        targets += found
    return np.array(off), targets


@pytest.mark.parametrize(
    ("sight", "most_px"),
    [
        (Sight(21, 0), 0.06),
        (Sight(28, 60), 0.12),  # 21 px across
        (Sight(40, 45), 0.04),
        (Sight(40, 30, blur_px=1.5), 0.12),
        (Sight(40, 30, noise=12), 0.10),
        (Sight(30, 30, black=90, white=120), 0.12),
        (Sight(160, 50), 0.02),
    ],
)
def test_targets_are_found_with_centres_to_a_part_of_a_pixel(sight: Sight, most_px: float) -> None:
    off, targets = errors(sight)
    rms = np.sqrt((off**2).mean())
    assert rms < most_px
    assert np.abs(off.mean(axis=0)).max() < 3 * most_px / np.sqrt(len(off))
    predicted = np.sqrt(np.mean([target.deviation_px**2 for target in targets]))
    assert 0.4 < predicted / rms < 3


def test_the_centre_is_where_the_lens_shows_it() -> None:
    """A large target in the corner of a picture by a lens that bends lines: the crossing of diagonals is off there."""
    lens = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 900, 1200, 800)
    lens.params = [900, 600, 400, -0.15]
    picture = target_picture(Sight(150, 30, noise=1), np.random.default_rng(8))
    flat = picture.grey
    place = np.array((700.0, 500.0)) - picture.centre_px  # of the ideal picture, where the lens is taken away
    rows, columns = np.mgrid[0:800, 0:1200]
    ideal = np.asarray(
        lens.cam_from_img(np.column_stack((columns.ravel() + 0.5, rows.ravel() + 0.5)))
    ) * 900 + (450, 250)
    local = (ideal - place - 0.5).reshape(800, 1200, 2).astype(np.float32)
    bent = np.asarray(
        cv2.remap(flat, local[..., 0], local[..., 1], cv2.INTER_CUBIC, borderValue=(120,)), np.uint8
    )
    ray = np.append((picture.centre_px + place - (450, 250)) / 900, 1)
    true = np.asarray(lens.img_from_cam(ray))
    with_lens, without = (find_targets(bent, camera=camera)[0].centre_px for camera in (lens, None))
    assert np.abs(with_lens - true).max() < 0.04
    assert np.abs(without - true).max() > 2 * np.abs(with_lens - true).max()


def test_a_picture_without_targets_has_none() -> None:
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (60, 80)).astype(np.uint8)
    blocks = np.asarray(cv2.resize(coarse, None, fx=12, fy=12, interpolation=cv2.INTER_NEAREST), np.uint8)
    assert find_targets(blocks) == []
    assert find_targets(np.full((100, 100), 128, np.uint8)) == []


def test_the_same_target_twice_in_a_picture_is_found_twice() -> None:
    picture = pictures(Sight(40, 20), 1)[0]
    both = find_targets(np.hstack((picture.grey, picture.grey)))
    assert [target.name for target in both] == [target_name(picture.number)] * 2
    assert both[0].centre_px[0] != pytest.approx(both[1].centre_px[0], abs=50)


def test_a_dictionary_is_known_by_several_spellings() -> None:
    known = [dictionary_of(name).markerSize for name in ("APRILTAG_36h11", "apriltag-36h11", "DICT_4X4_50")]
    assert known == [6, 6, 4]
    rng = np.random.default_rng(1)
    picture = target_picture(Sight(60, 30), rng, "4x4_50")
    assert [one.name for one in find_targets(picture.grey, "4x4-50")] == [target_name(picture.number)]
    with pytest.raises(OptionError, match="'apriltag_36h12' is no dictionary of targets") as caught:
        dictionary_of("apriltag_36h12")
    assert "APRILTAG_36h11" in caught.value.hint.upper().replace("H", "h")
