"""Relief of a drawing as pictures and lines."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.relief import (
    contour_levels,
    contour_lines,
    deviation_colours,
    deviation_range,
    hillshade,
    legend_stops,
    outline,
    with_legend,
)

GRID = PixelGrid(-1.0, 1.0, 0.01, 200, 200)
ACROSS, UP = np.meshgrid(GRID.across(), GRID.up())
BULGE = (0.05 - 0.1 * (ACROSS**2 + UP**2)).astype(np.float32)
"""Five centimetres out in its middle, on the plane at 0.707 from there."""


def test_contour_lines_of_a_bulge_are_circles() -> None:
    lines = contour_lines(BULGE, GRID, [0.0, 0.04])
    for level, radius in ((0.0, 0.5**0.5), (0.04, 0.1**0.5)):
        (line,) = lines[level]
        assert line.closed
        assert np.linalg.norm(line.points, axis=1) == pytest.approx(radius, abs=0.005)


def test_contour_lines_end_at_holes() -> None:
    holed = BULGE.copy()
    holed[:, :100] = np.nan
    (line,) = contour_lines(holed, GRID, [0.0])[0.0]
    assert not line.closed and line.points[:, 0].min() >= 0


def test_levels_are_round() -> None:
    assert contour_levels(BULGE, 0.02) == pytest.approx([k * 0.005 for k in (-4, -3, -2, -1, 1, 2, 3, 4)])
    plan = contour_levels(np.linspace(101.3, 112.8, 2000, dtype=np.float32), None)
    assert plan[0] == pytest.approx(101.5) and np.diff(plan) == pytest.approx(0.5)


def test_the_outline_goes_along_pixels_and_around_holes() -> None:
    covered = np.zeros((200, 200), bool)
    covered[20:180, 40:160] = True  # 1.2 by 1.6
    covered[90:110, 90:110] = False
    covered[5, 5] = True  # too small to count
    around, hole = sorted(outline(covered, GRID, 0.01), key=lambda line: -np.ptp(line.points))
    assert around.closed and np.ptp(around.points, axis=0) == pytest.approx(np.array((1.2, 1.6)), abs=0.011)
    assert np.ptp(hole.points, axis=0) == pytest.approx(np.array((0.2, 0.2)), abs=0.011)


def test_light_comes_from_the_upper_left() -> None:
    shade = hillshade(BULGE, GRID.pixel)
    assert shade[60, 60] > shade[100, 100] > shade[140, 140]
    assert hillshade(np.full((3, 3), np.nan, np.float32), 1)[1, 1] == 255


def test_colours_of_deviations_are_those_of_the_legend() -> None:
    stops = legend_stops(0.02)
    values = np.array([[value for value, _ in stops] + [0.021, np.nan]], np.float32)
    values[0, [0, -3]] *= 0.9999
    colours = deviation_colours(values, 0.02)[0]
    assert np.abs(colours[:5].astype(int) - [colour for _, colour in stops]).max() <= 1
    assert colours[5].tolist() == [225, 225, 225] and colours[6].tolist() == [255, 255, 255]
    assert colours[0][2] > colours[0][0] and colours[4][0] > colours[4][2]  # blue behind, red in front
    shown = with_legend(np.zeros((50, 700, 3), np.uint8), 20, "mm")
    assert shown.shape == (120, 700, 3) and (shown[60:75, 25] != 255).any()


def test_the_range_of_a_map_is_of_what_lies_near_the_plane() -> None:
    wall = np.random.default_rng(0).normal(0, 0.005, (100, 100)).astype(np.float32)
    wall[:40] += 1.0  # a column before it
    assert deviation_range(wall, 10.0) == pytest.approx(0.01)
