"""Cut space into cells, so that a large set is fused one cell at a time, from what its images show of it.

Cells are boxes that fill space and do not overlap: each point of the cloud belongs to exactly one of them. They are cut
at medians of what the depth maps show, like the cells of a k-d tree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.dense.camera import Bool, Float64, Int64

_MARGIN = 0.02  # of the distance of what is seen: depths that are fused differ by half of that at most
_LEAST_GAIN = 0.95  # a cut that leaves a side more than this share of the cost is not worth it


@dataclass(frozen=True)
class PixelCoverage:
    """Hold what images show, on a grid.

    `points` (N, 3) in the world, `image` (N,) the index of the image that shows each, in rising order, `pixel` (N, 2)
    where, `distance` (N,) how far away, `step` (N,) of the grid in pixels.
    """

    points: Float64
    image: Int64
    pixel: Int64
    distance: Float64
    step: Int64


@dataclass(frozen=True)
class Price:
    """Hold the cost of a pixel of an image, and of what is made of a pixel with depth, in any unit."""

    map: float
    point: float


@dataclass(frozen=True)
class Cell:
    """Describe a box, `low` <= x < `high` (3,), open to infinity at the outside.

    `images` are the indices of those that see into it or to within `margin` of it; `cost` is the price of what they
    show there.
    """

    low: Float64
    high: Float64
    margin: float
    images: tuple[int, ...]
    cost: float

    def holds(self, points: NDArray[np.floating], margin: float = 0.0) -> Bool:
        """Return (N,), true where `points` (N, 3) lie in the box, or within `margin` of it."""
        return np.asarray(((points >= self.low - margin) & (points < self.high + margin)).all(axis=1))


def cells_of(coverage: PixelCoverage, price: Price, most: float) -> list[Cell]:
    """Return cells that cost `most` at most, where cutting can achieve that.

    Of each image only the window counts in which it shows the cell.
    """

    def cut(whole: Cell) -> Iterator[Cell]:
        inner = coverage.points[whole.holds(coverage.points)]
        if whole.cost > most and len(inner):
            pairs = []
            for axis in range(3):
                low, high = whole.low.copy(), whole.high.copy()
                low[axis] = high[axis] = np.median(inner[:, axis])
                pairs.append([_cell(coverage, price, *box) for box in ((whole.low, high), (low, whole.high))])
            halves = min(pairs, key=lambda pair: max(half.cost for half in pair))
            if max(half.cost for half in halves) <= _LEAST_GAIN * whole.cost:
                for half in halves:
                    yield from cut(half)
                return
        yield whole

    everywhere = np.full(3, np.inf)
    return list(cut(_cell(coverage, price, -everywhere, everywhere)))


def _cell(coverage: PixelCoverage, price: Price, low: Float64, high: Float64) -> Cell:
    box = Cell(low, high, 0.0, (), 0.0)
    inside = box.holds(coverage.points)
    margin = _MARGIN * float(np.median(coverage.distance[inside])) if inside.any() else 0.0
    near = box.holds(coverage.points, margin)
    images, starts = np.unique(coverage.image[near], return_index=True)
    if not len(images):
        return box
    pixel, step = coverage.pixel[near], coverage.step[near][starts]
    sides = np.maximum.reduceat(pixel, starts) - np.minimum.reduceat(pixel, starts) + 2 * step[:, None]
    pixels, shown = float(sides.prod(axis=1).sum()), float((coverage.step[inside] ** 2).sum())
    return Cell(low, high, margin, tuple(images.tolist()), price.map * pixels + price.point * shown)
