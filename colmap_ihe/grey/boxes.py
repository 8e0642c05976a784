"""Colours gathered into boxes, and what is known of a grey histogram when only the boxes are.

A box reaches a short run of grey levels; where in the run its pixels fall is not known. That gives a bound
below the sum of squared counts, which leaves triplets out without counting them (`kernels.bound_boxes`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey import kernels
from colmap_ihe.grey.histogram import LINEAR_EDGES, Histogram
from colmap_ihe.grey.rules import Rules
from colmap_ihe.machine.threads import local_workers

Triplet = tuple[int, int, int]
"""Weights of red, green and blue in hundredths."""

WHITE_PERCENTILE = 99.8
"""Of a linear grey; the share of pixels at or below the white point of the set, in percent."""
WHITE_STEP = 1024
"""White points are multiples of it, in units of i R + j G + k B: 6,400 of them up to saturation."""

_CHUNK = 64


@dataclass(frozen=True)
class Boxes:
    """M boxes: their least and greatest R, G, B, planes (3, M) float32 of whole numbers, and their mass (M,)."""

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    mass: NDArray[np.uint64]

    def __len__(self) -> int:
        return len(self.mass)


NO_BOXES = Boxes(np.zeros((3, 0), np.float32), np.zeros((3, 0), np.float32), np.zeros(0, np.uint64))


class Pyramid:
    """The occupied cells of a histogram, in boxes of any power of two codes a side."""

    def __init__(self, histogram: Histogram) -> None:
        self._linear = histogram.encoding == "linear"
        self._keys, self._masses = histogram.occupied()
        self._total = int(self._masses.sum())

    def boxes(self, bits: int) -> Boxes:
        """All cells, in cubes of 2^bits codes; with 0 bits coded boxes are of one colour."""
        _, together = kernels.gather(self._keys, self._masses, bits, self._total)
        return self._boxes(together)

    def adaptive(self, bits: int, heavy: int) -> tuple[Boxes, Boxes]:
        """Cells of more than 2^-heavy of the mass, and the others in cubes: what a bound loses goes with the
        mass that it spreads, and a burnt-out sky alone would be most of it."""
        alone, together = kernels.gather(self._keys, self._masses, bits, self._total >> heavy)
        return self._boxes(alone), self._boxes(together)

    def _boxes(self, gathered: kernels.Gathered) -> Boxes:
        low, high, mass = gathered
        if self._linear:
            upper = LINEAR_EDGES[high.astype(np.intp) + 1] - 1
            return Boxes(_plane(LINEAR_EDGES[low]), _plane(upper), mass.copy())
        return Boxes(_plane(low), _plane(high), mass.copy())


def _plane(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)


def bounds_of(alone: Boxes, together: Boxes, rules: Rules) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A lower bound of the sum of squared counts by each rule, and its estimate: (m,) each. The boxes of `alone`
    are of one colour."""

    def bound(some: Rules) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        known = kernels.count_boxes(alone.low, alone.mass, some)
        return kernels.bound_boxes(together.low, together.high, together.mass, some, known)

    parts = _in_chunks(rules, bound)
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def counts_of(boxes: Boxes, rules: Rules) -> NDArray[np.uint64]:
    """Grey histograms (m, 256) of coded boxes of one colour each."""
    return np.concatenate(_in_chunks(rules, lambda some: kernels.count_boxes(boxes.low, boxes.mass, some)))


def whites_of(boxes: Boxes, triplets: Sequence[Triplet]) -> list[int]:
    """The white point of each linear grey in units of i R + j G + k B. Each box counts with its middle: the
    definition, not an approximation of one, for it has to be the same however the set is split."""
    rules = np.zeros((len(triplets), 6), np.float32)
    rules[:, :3] = triplets
    total = int(boxes.mass.sum())
    needed = total * round(10 * WHITE_PERCENTILE) // 1000
    middles = boxes.low + boxes.high  # twice the middle
    parts = _in_chunks(
        rules, lambda some: kernels.quantile_boxes(middles, boxes.mass, some, 2 * WHITE_STEP, needed)
    )
    return [(int(place) + 1) * WHITE_STEP for place in np.concatenate(parts)]


def _in_chunks(rules: Rules, function: Callable[[Rules], Any]) -> list[Any]:
    """`function` of some rules at a time, on all cores, in order."""
    chunks = [np.ascontiguousarray(rules[i : i + _CHUNK]) for i in range(0, len(rules), _CHUNK)]
    with ThreadPoolExecutor(local_workers()) as pool:
        return list(pool.map(function, chunks))
