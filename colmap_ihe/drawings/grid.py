"""Lay the pixels of a drawing: which part of it they show, and how large each is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Float64

MOST_PIXELS = 1_000_000_000
"""Of a drawing: 4 GB as an orthophoto."""

BAND_PIXELS = 8_000_000
"""That are in memory at a time."""

BLOCK = 512
"""Pixels along a side of the tiles of a file, of which bands are whole rows."""

_NICE = (1.0, 2.0, 2.5, 5.0)


@dataclass(frozen=True)
class PixelGrid:
    """Hold a grid of `width` x `height` square pixels with sides of `pixel`, in units of the model; `left` and `top`
    are the outer edges of the first one, across and up on the drawing."""

    left: float
    top: float
    pixel: float
    width: int
    height: int

    @property
    def right(self) -> float:
        return self.left + self.width * self.pixel

    @property
    def bottom(self) -> float:
        return self.top - self.height * self.pixel

    def across(self) -> Float64:
        """Return (width,), where the middles of the columns are."""
        return np.asarray(self.left + (np.arange(self.width) + 0.5) * self.pixel, np.float64)

    def up(self) -> Float64:
        """Return (height,), where the middles of the rows are."""
        return np.asarray(self.top - (np.arange(self.height) + 0.5) * self.pixel, np.float64)

    def pixels(self, places: Float64) -> Float64:
        """Return (..., 2): column and row of places (..., 2 or more) of the drawing, (0.5, 0.5) in the first pixel's
        middle."""
        column, row = (places[..., 0] - self.left) / self.pixel, (self.top - places[..., 1]) / self.pixel
        return np.stack((column, row), axis=-1)

    def part(self, column: int, row: int, width: int, height: int) -> PixelGrid:
        """Return the pixels from `column` and `row` on, as far as there are any."""
        return PixelGrid(
            self.left + column * self.pixel,
            self.top - row * self.pixel,
            self.pixel,
            min(width, self.width - column),
            min(height, self.height - row),
        )

    def bands(self, most: int = BAND_PIXELS) -> Iterator[tuple[int, PixelGrid]]:
        """Yield bands of rows of at most so many pixels, each with its first row."""
        rows = max(BLOCK, most // self.width // BLOCK * BLOCK)
        for row in range(0, self.height, rows):
            yield row, self.part(0, row, self.width, rows)


def grid_over(left: float, bottom: float, right: float, top: float, pixel: float) -> PixelGrid:
    """Return the grid over a rectangle, its edges on whole pixels from the origin of the drawing on, so that two
    drawings of one plane have their pixels in the same places."""
    first, last = math.floor(left / pixel), math.ceil(right / pixel)
    lowest, highest = math.floor(bottom / pixel), math.ceil(top / pixel)
    return PixelGrid(first * pixel, highest * pixel, pixel, max(1, last - first), max(1, highest - lowest))


def nice_size(size: float) -> float:
    """Return the largest of 1, 2, 2.5, 5, 10 ... times a power of ten that is no larger."""
    power = 10.0 ** math.floor(math.log10(size))
    return max(n * power for n in _NICE if n * power <= size * (1 + 1e-9))
