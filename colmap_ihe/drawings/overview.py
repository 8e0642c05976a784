"""Keep a smaller copy of a drawing in memory while its bands are made: for sheets, pictures and lines."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, UInt8
from colmap_ihe.drawings.colours import Band
from colmap_ihe.drawings.grid import BLOCK, PixelGrid

MOST_PIXELS = 20_000_000
"""Of an overview: a sheet of A1 at some 150 pixels an inch."""


@dataclass(frozen=True)
class Overview:
    """Hold a drawing on a coarser `grid`: `rgb` (H, W, 3) uint8, white where there is no surface, and `out` (H, W)
    float32, nan there. `times` as coarse. `seen` and `by_photograph` count pixels of the drawing as it is filled."""

    grid: PixelGrid
    times: int
    rgb: UInt8
    out: Float32
    counts: dict[str, int]

    def add(self, row: int, band: Band) -> None:
        """Add a band of the drawing that begins at `row`, a multiple of `times`."""
        there = ~np.isnan(band.out)
        self.counts["seen"] += int(there.sum())
        self.counts["by_photograph"] += int(band.by_photograph.sum())
        first = row // self.times
        out = _mean_out(band.out, there, self.times)
        part = np.s_[first : first + len(out)]
        self.out[part] = out
        self.rgb[part] = _mean_rgb(band.rgb, there, self.times)

    @property
    def covered(self) -> Bool:
        """Return (H, W), true where there is a surface."""
        return ~np.isnan(self.out)


def overview_of(grid: PixelGrid) -> Overview:
    """Return the empty overview of a drawing, coarser by a power of two, which bands are whole multiples of."""
    times = 1
    while grid.width * grid.height / times**2 > MOST_PIXELS and times < BLOCK:
        times *= 2
    height, width = -(-grid.height // times), -(-grid.width // times)
    coarse = PixelGrid(grid.left, grid.top, grid.pixel * times, width, height)
    rgb = np.full((height, width, 3), 255, np.uint8)
    return Overview(
        coarse, times, rgb, np.full((height, width), np.nan, np.float32), {"seen": 0, "by_photograph": 0}
    )


def _mean_out(out: Float32, there: Bool, times: int) -> Float32:
    if times == 1:
        return out
    total = _blocks(np.where(there, out, 0).astype(np.float32), times)
    share = _blocks(there.astype(np.float32), times)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(share >= 0.5, total / share, np.nan), np.float32)


def _mean_rgb(rgb: UInt8, there: Bool, times: int) -> UInt8:
    shown = np.where(there[..., None], rgb, np.uint8(255))
    return shown if times == 1 else np.asarray(np.rint(_blocks(shown.astype(np.float32), times)), np.uint8)


def _blocks(values: Float32, times: int) -> Float32:
    """Return the means over squares of `times` pixels a side, repeated at the edges to make them whole."""
    height, width = values.shape[:2]
    down, right = -height % times, -width % times
    whole = cv2.copyMakeBorder(values, 0, down, 0, right, cv2.BORDER_REPLICATE)
    size = (whole.shape[1] // times, whole.shape[0] // times)
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
