"""Space cut into cells, so that a large set is fused one cell at a time, by the images that see into it.

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

_MARGIN = 0.02  # of the distance of what is seen: depths that are fused differ by half of that at most
_LEAST_GAIN = 0.9  # a cut that leaves a side more than this share of the cost is not worth it


@dataclass(frozen=True)
class Seen:
    """What images show, thinned: `points` (N, 3) in the world, `image` (N,) the place of the image that shows each,
    and `distance` (N,) how far it is from there."""

    points: _F64
    image: _I64
    distance: _F64


@dataclass(frozen=True)
class Cell:
    """A box, `low` <= x < `high` (3,), open to infinity at the outside; the images that see into it or to within
    `margin` of it, by place; and what they cost."""

    low: _F64
    high: _F64
    margin: float
    images: tuple[int, ...]
    cost: float

    def holds(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(N,) whether each of `points` (N, 3) lies in the box."""
        return np.asarray(((points >= self.low) & (points < self.high)).all(axis=1))


def cells_of(seen: Seen, costs: _F64, most: float) -> list[Cell]:
    """Cells each of whose images cost `most` at most in sum, where cutting can bring that about.

    `costs` (images,): what it takes to hold an image, in any unit. Where all images see the same, however small it
    is, no cut helps and a cell costs more.
    """
    everywhere = np.full(3, np.inf)
    return list(_cut(seen, costs, most, -everywhere, everywhere))


def _cut(seen: Seen, costs: _F64, most: float, low: _F64, high: _F64) -> Iterator[Cell]:
    here = _cell(seen, costs, low, high)
    best: tuple[Cell, Cell] | None = None
    if here.cost > most:
        inner = seen.points[here.holds(seen.points)]
        pairs = []
        for axis in range(3) if len(inner) else ():
            middle = np.median(inner[:, axis])
            left, right = high.copy(), low.copy()
            left[axis] = right[axis] = middle
            pairs.append((_cell(seen, costs, low, left), _cell(seen, costs, right, high)))
        best = min(pairs, key=lambda pair: max(cell.cost for cell in pair), default=None)
    if best is None or max(cell.cost for cell in best) > _LEAST_GAIN * here.cost:
        yield here
        return
    for cell in best:
        yield from _cut(seen, costs, most, cell.low, cell.high)


def _cell(seen: Seen, costs: _F64, low: _F64, high: _F64) -> Cell:
    inside = ((seen.points >= low) & (seen.points < high)).all(axis=1)
    margin = _MARGIN * float(np.median(seen.distance[inside])) if inside.any() else 0.0
    near = ((seen.points >= low - margin) & (seen.points < high + margin)).all(axis=1)
    images = np.unique(seen.image[near])
    return Cell(low, high, margin, tuple(int(i) for i in images), float(costs[images].sum()))
