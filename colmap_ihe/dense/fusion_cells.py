"""Space cut into cells, so that a large set is fused one cell at a time, from what its images show of it.

Cells are boxes that fill space and do not overlap: each point of the cloud belongs to one of them, and none is
missing or twice at a border. They are cut at medians of what the depth maps show, like the cells of a k-d tree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_F64 = NDArray[np.float64]
_I64 = NDArray[np.int64]
_Bool = NDArray[np.bool_]

_MARGIN = 0.02  # of the distance of what is seen: depths that are fused differ by half of that at most
_LEAST_GAIN = 0.95  # a cut that leaves a side more than this share of the cost is not worth it


@dataclass(frozen=True)
class PixelCoverage:
    """What images show, on a grid: `points` (N, 3) in the world, `image` (N,) the place of the image that shows
    each, in rising order, `pixel` (N, 2) where, `distance` (N,) how far away, `step` (N,) of the grid in pixels."""

    points: _F64
    image: _I64
    pixel: _I64
    distance: _F64
    step: _I64


@dataclass(frozen=True)
class Price:
    """What it takes to hold a pixel of an image, and what comes of a pixel with depth, in any unit."""

    map: float
    point: float


@dataclass(frozen=True)
class Cell:
    """A box, `low` <= x < `high` (3,), open to infinity at the outside; the images that see into it or to within
    `margin` of it, by place; and the price of what they show there."""

    low: _F64
    high: _F64
    margin: float
    images: tuple[int, ...]
    cost: float

    def holds(self, points: NDArray[np.floating], margin: float = 0.0) -> _Bool:
        """(N,) whether each of `points` (N, 3) lies in the box, or that near to it."""
        return np.asarray(((points >= self.low - margin) & (points < self.high + margin)).all(axis=1))


def cells_of(seen: PixelCoverage, price: Price, most: float) -> list[Cell]:
    """Cells that cost `most` at most, where cutting can bring that about: of each image only the window counts in
    which it shows the cell."""
    everywhere = np.full(3, np.inf)
    return list(_cut(seen, price, most, -everywhere, everywhere))


def _cut(seen: PixelCoverage, price: Price, most: float, low: _F64, high: _F64) -> Iterator[Cell]:
    here = _cell(seen, price, low, high)
    best: tuple[Cell, Cell] | None = None
    if here.cost > most:
        inner = seen.points[here.holds(seen.points)]
        pairs = []
        for axis in range(3) if len(inner) else ():
            middle = np.median(inner[:, axis])
            left, right = high.copy(), low.copy()
            left[axis] = right[axis] = middle
            pairs.append((_cell(seen, price, low, left), _cell(seen, price, right, high)))
        best = min(pairs, key=lambda pair: max(cell.cost for cell in pair), default=None)
    if best is None or max(cell.cost for cell in best) > _LEAST_GAIN * here.cost:
        yield here
        return
    for cell in best:
        yield from _cut(seen, price, most, cell.low, cell.high)


def _cell(seen: PixelCoverage, price: Price, low: _F64, high: _F64) -> Cell:
    box = Cell(low, high, 0.0, (), 0.0)
    inside = box.holds(seen.points)
    margin = _MARGIN * float(np.median(seen.distance[inside])) if inside.any() else 0.0
    near = box.holds(seen.points, margin)
    images, starts = np.unique(seen.image[near], return_index=True)
    if not len(images):
        return box
    pixel, step = seen.pixel[near], seen.step[near][starts]
    sides = np.maximum.reduceat(pixel, starts) - np.minimum.reduceat(pixel, starts) + 2 * step[:, None]
    cost = price.map * float(sides.prod(axis=1).sum()) + price.point * float((seen.step[inside] ** 2).sum())
    return Cell(low, high, margin, tuple(int(i) for i in images), cost)
