"""Edges of squares, and where diagonals cross."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from colmap_ihe.survey.target_edges import crossing, square_of

CORNERS = np.array(((30.3, 28.6), (71.2, 33.1), (68.4, 75.9), (26.7, 69.5)))


def picture(black: int = 40, white: int = 200) -> np.ndarray:
    """(100, 100) uint8: a black quadrangle with corners at CORNERS, in OpenCV's pixels, on white."""
    fine = np.full((1600, 1600), white, np.uint8)
    cv2.fillConvexPoly(fine, np.rint((CORNERS + 0.5) * 16 - 0.5).astype(np.int32), (black,))
    return np.asarray(cv2.resize(fine, (100, 100), interpolation=cv2.INTER_AREA), np.uint8)


def test_diagonals_cross_where_a_tilted_square_has_its_centre() -> None:
    square = np.array(
        ((0, 0, 5), (2, 0, 6), (2, 2, 7), (0, 2, 6)), float
    )  # as a camera sees it: x, y, distance
    seen = square[:, :2] / square[:, 2:]
    np.testing.assert_allclose(crossing(seen), (1 / 6, 1 / 6))
    assert np.abs(seen.mean(axis=0) - 1 / 6).max() > 0.002


def test_a_square_is_measured_from_corners_that_are_off() -> None:
    start = CORNERS + np.array(((1.2, -0.8), (-0.9, 1.1), (0.7, 1.0), (-1.0, 0.4)))
    square = square_of(picture(), start, 8)
    assert square is not None
    np.testing.assert_allclose(square.corners_px, CORNERS + 0.5, atol=0.06)
    np.testing.assert_allclose(square.centre_px, crossing(CORNERS) + 0.5, atol=0.03)
    sides = np.linalg.norm(np.roll(CORNERS, -1, axis=0) - CORNERS, axis=1)
    assert square.side_px == pytest.approx(sides.mean(), abs=0.1)  # drawn with 16 steps a pixel
    assert square.off_px < 0.05


@pytest.mark.parametrize(
    "grey",
    [
        np.full((100, 100), 128, np.uint8),
        picture(black=200, white=40),
        np.repeat(np.arange(100, dtype=np.uint8)[None], 100, axis=0),
    ],
    ids=["flat", "white on black", "a slope"],
)
def test_where_no_dark_square_is_there_is_none(grey: np.ndarray) -> None:
    assert square_of(grey, CORNERS, 8) is None


def test_a_square_that_leaves_the_picture_is_none() -> None:
    assert square_of(picture()[:74], CORNERS, 8) is None
