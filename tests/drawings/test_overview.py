"""The smaller copy of a drawing."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.drawings import overview as room
from colmap_ihe.drawings.colours import Band
from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.overview import overview_of


def test_bands_become_one_picture_of_means(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "MOST_PIXELS", 30_000)
    grid = PixelGrid(0, 0, 0.1, 301, 700)
    rgb = np.repeat(np.arange(700, dtype=np.uint8)[:, None, None], 301, axis=1).repeat(3, axis=2)
    out = np.repeat(np.linspace(0, 1, 700, dtype=np.float32)[:, None], 301, axis=1)
    out[:, 200:] = np.nan
    overview = overview_of(grid)
    assert (overview.times, overview.rgb.shape) == (4, (175, 76, 3))
    for row, part in grid.bands(1):
        rows = np.s_[row : row + part.height]
        overview.add(row, Band(rgb[rows], out[rows], ~np.isnan(out[rows])))
    assert overview.counts == {"seen": 700 * 200, "by_photograph": 700 * 200}
    assert overview.covered[:, :50].all() and not overview.covered[:, 51:].any()
    assert overview.out[30, 10] == pytest.approx(out[120:124, 10].mean())
    assert overview.rgb[30, 10, 0] == pytest.approx(122, abs=1) and (overview.rgb[:, 60] == 255).all()
    assert (overview.grid.pixel, overview.grid.left) == (0.4, 0)
