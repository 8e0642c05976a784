"""Rims of plain areas beside an outline: of the sky and of a wall."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from colmap_ihe.dense.camera import Float32
from colmap_ihe.dense.stereo.rims import plain_ground, without_rims
from colmap_ihe.dense.stereo.views import StereoView

SIZE, OUTLINE, RIM_PX = (320, 240), 160, 5
K = np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]])
DEPTH, SHIFTS_PX = 4.0, (-20, 20)
INSIDE = np.s_[20:-20]  # rows
CABLE = np.s_[10:13, OUTLINE:]


def _view(columns: int, grain: float, seed: int) -> StereoView:
    """Return what a camera sees that stands so far to the right that all at `DEPTH` moves by `columns` to the left:
    dark stone left of `OUTLINE`; right of it a plain area with a `grain` of so many levels that moves as well, and with
    a noise of a level of its own."""
    scene = np.random.default_rng(1).normal(size=(SIZE[1], SIZE[0] + 100))
    scene[:, : OUTLINE + 50] = 90 + 20 * scene[:, : OUTLINE + 50]
    scene[:, OUTLINE + 50 :] = 200 + grain * scene[:, OUTLINE + 50 :]
    seen = scene[:, 50 + columns : 50 + columns + SIZE[0]]
    noise = np.random.default_rng(seed).normal(size=seen.shape)
    pose = np.column_stack([np.eye(3), [-columns * DEPTH / K[0, 0], 0, 0]])
    return StereoView(K, pose, SIZE, np.clip(np.round(seen + noise), 0, 255).astype(np.uint8))


def _blurred_with_a_cable(view: StereoView) -> StereoView:
    """Return `view` with a dark cable along `CABLE` before the plain area, as a lens blurs it."""
    grey = view.grey_u8.copy()
    grey[CABLE] = 90
    return replace(view, grey_u8=np.asarray(cv2.GaussianBlur(grey, (0, 0), 0.7), np.uint8))


def _views(grain: float) -> tuple[StereoView, list[StereoView]]:
    return _view(0, grain, 10), [_view(shift, grain, 20 + shift) for shift in SHIFTS_PX]


@pytest.fixture
def inverse() -> Float32:
    """Return the depth of the stone, with a rim beyond its outline."""
    inverse = np.zeros(SIZE[::-1], np.float32)
    inverse[:, : OUTLINE + RIM_PX] = 1 / DEPTH
    return inverse


def test_the_rim_of_the_sky_is_dropped_and_nothing_of_the_stone(inverse: Float32) -> None:
    result = without_rims(*_views(grain=0), inverse)
    assert (result[:, :OUTLINE] == inverse[:, :OUTLINE]).mean() > 0.999
    assert (result[INSIDE, OUTLINE : OUTLINE + RIM_PX] == 0).mean() > 0.95


def test_the_rim_of_a_wall_whose_grain_is_at_that_depth_stays(inverse: Float32) -> None:
    result = without_rims(*_views(grain=1.0), inverse)
    assert (result == inverse).all()


def test_a_sky_whose_noise_matched_is_dropped_as_a_whole_and_a_wall_stays(inverse: Float32) -> None:
    everywhere = np.full_like(inverse, 1 / DEPTH)
    sky = without_rims(*_views(grain=0), everywhere)
    assert (sky[INSIDE, OUTLINE:] == 0).mean() > 0.9
    assert (sky[:, :OUTLINE] > 0).mean() > 0.999
    assert (without_rims(*_views(grain=1.0), everywhere) > 0).all()


def test_the_blur_of_an_outline_goes_with_the_sky_and_a_cable_of_three_pixels_stays(inverse: Float32) -> None:
    reference, sources = _views(grain=0)
    blurred = [_blurred_with_a_cable(view) for view in (reference, *sources)]
    result = without_rims(blurred[0], blurred[1:], inverse)
    assert (result[INSIDE, OUTLINE + 1 : OUTLINE + RIM_PX] == 0).mean() > 0.95
    assert (result[INSIDE, : OUTLINE - 1] > 0).all()
    inverse[CABLE] = 1 / DEPTH
    assert (without_rims(blurred[0], blurred[1:], inverse)[CABLE][:, :-RIM_PX] > 0).all()


def test_a_wall_farther_away_is_no_other_than_the_sky(inverse: Float32) -> None:
    reference, _ = _views(grain=1.0)
    sources = [
        replace(_view(s // 2, 1.0, 30 + s), cam_from_world=_view(s, 1.0, 1).cam_from_world) for s in SHIFTS_PX
    ]
    result = without_rims(reference, sources, inverse)
    assert (result[INSIDE, OUTLINE : OUTLINE + RIM_PX] == 0).mean() > 0.95


def test_what_no_source_sees_and_what_is_masked_stays(inverse: Float32) -> None:
    reference, sources = _views(grain=0)
    turned = [replace(s, cam_from_world=np.diag([1.0, -1, -1]) @ s.cam_from_world) for s in sources]
    assert (without_rims(reference, turned, inverse) == inverse).all()
    mask = np.full(SIZE[::-1], 255, np.uint8)
    mask[:, OUTLINE:] = 0
    assert (without_rims(replace(reference, mask_u8=mask), sources, inverse) == inverse).all()
    assert not without_rims(reference, sources, np.zeros_like(inverse)).any()


def test_plain_ground_is_the_sky_up_to_its_depth_and_no_stone(inverse: Float32) -> None:
    grey = _view(0, 0, 10).grey_u8
    ground = plain_ground(grey, inverse)
    assert ground[INSIDE, OUTLINE + RIM_PX :].mean() > 0.99
    assert not ground[:, : OUTLINE + RIM_PX].any()
    assert not plain_ground(grey, np.ones_like(inverse)).any()
