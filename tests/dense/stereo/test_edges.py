"""Edges of depth maps that are wrong by known amounts, moved back."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from planes import camera, plane, render

from colmap_ihe.dense.camera import Float32, Float64
from colmap_ihe.dense.stereo.edges import sharpened
from colmap_ihe.dense.stereo.views import StereoView

FRONT, BACK = plane(3.0, 0, 0, (0.5, 0.5), seed=2), plane(5.0, 0.1, 0, (5.0, 5.0), seed=3)
REFERENCE = camera([0, 0, 0])
SOURCES = [camera([x, y, 0]) for x, y in ((-0.4, 0), (0.4, 0), (0, 0.4), (0, -0.4))]
ONE_PIXEL = 1 / (420 * 0.4)


@pytest.fixture(scope="module")
def scene() -> tuple[StereoView, list[StereoView], Float64]:
    view, truth = render(REFERENCE, [FRONT, BACK])
    return view, [render(source, [FRONT, BACK])[0] for source in SOURCES], truth


def _shifted(truth: Float64, columns: int) -> Float32:
    """Return true inverse depth whose edges are moved by so many columns to the right."""
    return (1 / np.roll(truth, columns, axis=1)).astype(np.float32)


def _wrong(inverse: Float32, truth: Float64) -> float:
    """Return the share of the depths within 6 pixels of the front plane's left and right rims that are wrong."""
    rims = np.flatnonzero(np.diff(truth[150]) != 0)
    rims = rims[np.abs(np.diff(truth[150])[rims]) > 0.5]
    assert len(rims) == 2
    columns = np.concatenate([np.arange(rim - 5, rim + 7) for rim in rims])
    part = np.s_[90:210, columns]
    return float((np.abs(inverse[part] * truth[part] - 1) > 0.02).mean())


def test_a_moved_edge_goes_back(scene: tuple[StereoView, list[StereoView], Float64]) -> None:
    """The front plane is too wide by 4 pixels on the right, and by as many too narrow on the left."""
    view, sources, truth = scene
    moved = _shifted(truth, 4)
    assert _wrong(moved, truth) == pytest.approx(4 / 12, abs=0.02)
    assert _wrong(sharpened(view, sources, moved, ONE_PIXEL), truth) < 0.05


def test_a_right_edge_stays(scene: tuple[StereoView, list[StereoView], Float64]) -> None:
    view, sources, truth = scene
    result = sharpened(view, sources, _shifted(truth, 0), ONE_PIXEL)
    assert _wrong(result, truth) < 0.03
    away = np.s_[100:200, 170:230]  # in the middle of the front plane
    assert (result[away] == _shifted(truth, 0)[away]).all()


def test_holes_beside_an_edge_are_filled_with_the_side_that_is_seen(
    scene: tuple[StereoView, list[StereoView], Float64],
) -> None:
    view, sources, truth = scene
    holed = _shifted(truth, 0)
    rim = int(np.flatnonzero(np.abs(np.diff(truth[150])) > 0.5)[0])
    holed[90:210, rim - 3 : rim + 1] = 0
    result = sharpened(view, sources, holed, ONE_PIXEL)
    rim_part = np.s_[90:210, rim - 3 : rim + 1]
    assert (result[rim_part] > 0).mean() > 0.7
    assert _wrong(result, truth) < 0.2
    hidden = np.full(truth.shape, 255, np.uint8)
    hidden[:, rim - 3 : rim + 1] = 0
    assert not sharpened(replace(view, mask_u8=hidden), sources, holed, ONE_PIXEL)[rim_part].any()


def test_a_surface_without_edges_stays_as_it_is() -> None:
    steep = plane(4.0, 1.2, 0, (9.0, 9.0), seed=1)
    view, truth = render(REFERENCE, [steep])
    sources = [render(source, [steep])[0] for source in SOURCES]
    inverse = np.where(truth > 0, 1 / np.maximum(truth, 1e-9), 0).astype(np.float32)
    assert (sharpened(view, sources, inverse, ONE_PIXEL) == inverse).all()
    assert not sharpened(view, sources, np.zeros_like(inverse), ONE_PIXEL).any()


def test_a_dark_pole_that_is_too_wide_is_as_wide_as_it_shows() -> None:
    """The pole is two pixels wide, the window that is compared five."""
    pole = plane(3.0, 0, 0, (0.01, 2.0), seed=4)
    views = [render(camera, [pole, BACK]) for camera in (REFERENCE, *SOURCES)]
    view, *sources = (_darker(view, truth < 4) for view, truth in views)
    truth = views[0][1]
    wide = np.asarray(cv2.dilate(_shifted(truth, 0), np.ones((1, 7), np.uint8)), np.float32)
    result = np.asarray(sharpened(view, sources, wide, ONE_PIXEL))
    rows = slice(60, 240)
    own = truth[rows] < 4
    beside = np.asarray(cv2.dilate(own.astype(np.uint8), np.ones((1, 7), np.uint8)) > 0) & ~own
    right = np.abs(result[rows] * truth[rows] - 1) < 0.02
    assert right[own].mean() > 0.95
    assert right[beside].mean() > 0.9


def _darker(view: StereoView, where: NDArray[np.bool_]) -> StereoView:
    grey = np.where(where, view.grey_u8 // 3, view.grey_u8 // 3 + 120)
    return replace(view, grey_u8=grey.astype(np.uint8))
