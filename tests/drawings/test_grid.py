"""The pixels of a drawing."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.drawings.grid import BLOCK, PixelGrid, grid_over, nice_size


def test_edges_lie_on_whole_pixels_so_that_two_drawings_of_a_plane_fit() -> None:
    grid = grid_over(-0.11, 0.02, 1.0, 0.97, 0.05)
    assert (grid.width, grid.height) == (23, 20)
    assert [grid.left, grid.top] == pytest.approx([-0.15, 1.0])
    assert [grid.right, grid.bottom] == pytest.approx([1.0, 0.0])
    assert grid.across()[0] == pytest.approx(-0.125) and grid.up()[-1] == pytest.approx(0.025)
    assert grid.pixels(np.array((-0.125, 0.975))) == pytest.approx(np.array((0.5, 0.5)))


def test_bands_are_whole_rows_of_tiles_and_cover_all() -> None:
    grid = PixelGrid(0, 0, 1, 1000, 2000)
    bands = list(grid.bands(600_000))
    assert [(row, part.height) for row, part in bands] == [
        (n * BLOCK, min(BLOCK, 2000 - n * BLOCK)) for n in range(4)
    ]
    assert bands[1][1].top == -BLOCK


@pytest.mark.parametrize(("size", "nice"), [(0.0062, 0.005), (0.005, 0.005), (2.4, 2), (2.6, 2.5), (99, 50)])
def test_sizes_are_nice_to_read(size: float, nice: float) -> None:
    assert nice_size(size) == pytest.approx(nice)
