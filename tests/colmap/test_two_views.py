"""Features, matches and verification of two images of a plane whose homography is known."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from oracle import blobs

from colmap_ihe.colmap import two_views
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.colmap.two_views import Features, features_of, match, verified

HOMOGRAPHY = np.array([[0.96, 0.08, 12.0], [-0.06, 1.02, 9.0], [4e-5, -3e-5, 1.0]])
SIZE = (420, 320)


def texture(seed: int) -> NDArray[np.uint8]:
    return np.asarray(np.clip(127 + 62 * blobs(seed, *SIZE), 0, 255), np.uint8)


def pair(seed: int = 1) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    first = texture(seed)
    second: Any = cv2.warpPerspective(first, HOMOGRAPHY, SIZE, flags=cv2.INTER_CUBIC)
    return first, np.asarray(second, np.uint8)


def places_of(one: Features, other: Features) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    pairs = match(one, other)
    first, second = one.places[pairs[:, 0]], other.places[pairs[:, 1]]
    kept = verified(first, second, SIZE, SIZE)
    return first[kept], second[kept]


@pytest.fixture(scope="module")
def found() -> list[Features]:
    with quiet():
        return features_of([*pair(), np.full(SIZE[::-1], 90, np.uint8)])


def test_inliers_obey_the_homography_and_are_most_of_what_both_images_show(found: list[Features]) -> None:
    first, second = places_of(found[0], found[1])
    there = cv2.perspectiveTransform(first[:, None], HOMOGRAPHY)[:, 0]
    errors = np.linalg.norm(there - second, axis=1)
    assert np.median(errors) < 0.3, f"{np.median(errors)=} px"
    assert np.mean(errors < 2) > 0.97
    assert len(found[0]) * 0.4 < len(first) < len(found[0]), f"{len(first)} of {len(found[0])}"


def test_matches_are_those_of_colmaps_matcher(found: list[Features]) -> None:
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = 1
    few = [Features(f.places[-400:], f.scales[-400:], f.descriptors[-400:]) for f in found[:2]]
    with quiet():
        matcher = pycolmap.FeatureMatcher.create(options, pycolmap.Device.cpu)
        places = pycolmap.FeatureKeypoints()  # which it does not look at
        sift = pycolmap.FeatureExtractorType.SIFT
        one, other = (pycolmap.FeatureDescriptors(sift, f.descriptors) for f in few)
        expected = {(int(a), int(b)) for a, b in matcher.match(places, one, places, other)}
    mine = {(int(a), int(b)) for a, b in match(*few)}
    assert len(expected) > 100
    # Angles that are equal but for rounding may fall on either side of the ratio.
    assert len(mine ^ expected) <= 0.01 * len(expected), f"{len(mine)=} {len(expected)=}"


def test_a_blank_image_has_no_features_and_matches_nothing(found: list[Features]) -> None:
    assert len(found[2]) == 0
    assert match(found[0], found[2]).shape == (0, 2)
    assert match(found[2], found[0]).shape == (0, 2)
    nothing = np.zeros((0, 2))
    assert verified(nothing, nothing, SIZE, SIZE).shape == (0,)


def test_images_of_two_scenes_share_no_geometry(found: list[Features]) -> None:
    with quiet():
        (other,) = features_of([texture(7)])
    assert len(places_of(found[0], other)[0]) == 0


def test_the_same_images_give_the_same_answer(found: list[Features]) -> None:
    with quiet():
        again = features_of(pair())
    for one, other in zip(found[:2], again, strict=True):
        assert np.array_equal(one.descriptors, other.descriptors)
    assert all(map(np.array_equal, places_of(found[0], found[1]), places_of(again[0], again[1])))


def test_blocks_of_rows_change_no_match(found: list[Features], monkeypatch: pytest.MonkeyPatch) -> None:
    whole = match(found[0], found[1])
    monkeypatch.setattr(two_views, "_ROWS", 37)
    assert np.array_equal(match(found[0], found[1]), whole)


def test_the_first_octave_is_of_features_smaller_than_two_pixels(found: list[Features]) -> None:
    with quiet():
        (coarse,) = features_of([pair()[0]], first_octave=0)
    assert coarse.scales.min() > 1.5
    assert len(coarse) < len(found[0])
    assert len(coarse) == pytest.approx((found[0].scales > 1.8).sum(), rel=0.15)


def test_what_is_no_grey_image_is_refused() -> None:
    assert features_of([]) == []
    with pytest.raises(ValueError, match="expected \\(H, W\\) uint8"):
        features_of([np.zeros((9, 9, 3), np.uint8)])
    with pytest.raises(ValueError, match="expected \\(N, 2\\)"):
        verified(np.zeros((4, 2)), np.zeros((5, 2)), SIZE, SIZE)
