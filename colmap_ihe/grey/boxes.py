"""Gather the colours of a linear set into boxes, each of a short run of grey levels: white points and estimates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey import kernels
from colmap_ihe.grey.histogram import LINEAR_EDGES, Cells
from colmap_ihe.grey.weights import Rules, Triplet
from colmap_ihe.machine.threads import local_workers

WHITE_PERCENTILE = 99.8
"""Of a linear grey; the share of pixels at or below the white point of the set, in percent."""
WHITE_STEP = 1024
"""White points are multiples of it, in units of i R + j G + k B: 6,400 of them up to saturation."""

_CHUNK = 64


@dataclass(frozen=True)
class Boxes:
    """Hold M boxes: their least and greatest linear R, G, B, (3, M) float32 of whole numbers, and their mass (M,)."""

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    mass: NDArray[np.uint64]

    def __len__(self) -> int:
        return len(self.mass)


def boxes_of(cells: Cells, bits: int) -> Boxes:
    """Return occupied cells of a linear histogram in cubes of 2^bits cells a side."""
    keys, masses = cells
    low, high, mass = kernels.gather(keys, masses, bits)
    least, greatest = LINEAR_EDGES[low], LINEAR_EDGES[high.astype(np.intp) + 1] - 1
    return Boxes(np.ascontiguousarray(least, np.float32), np.ascontiguousarray(greatest, np.float32), mass)


def estimates_of(boxes: Boxes, rules: Rules) -> NDArray[np.float64]:
    """Return for each rule the sum of squared counts, (m,), with pixels spread evenly over the levels of their box."""
    parts = _in_chunks(rules, lambda some: kernels.estimate_boxes(boxes.low, boxes.high, boxes.mass, some))
    return np.concatenate(parts)


def whites_of(boxes: Boxes, triplets: Sequence[Triplet]) -> list[int]:
    """Return the white point of each linear grey in units of i R + j G + k B. Each box counts with its middle: the
    definition, not an approximation of one, for it has to be the same however the set is split."""
    rules = np.zeros((len(triplets), 6), np.float32)
    rules[:, :3] = triplets
    total = int(boxes.mass.sum())
    needed = total * round(10 * WHITE_PERCENTILE) // 1000
    middles = boxes.low + boxes.high  # twice the middle
    parts = _in_chunks(
        rules, lambda some: kernels.quantile_boxes(middles, boxes.mass, some, 2 * WHITE_STEP, needed)
    )
    return [(int(step) + 1) * WHITE_STEP for step in np.concatenate(parts)]


def _in_chunks(rules: Rules, function: Callable[[Rules], Any]) -> list[Any]:
    """Return `function` of some rules at a time, computed on all cores, in order."""
    chunks = [np.ascontiguousarray(rules[i : i + _CHUNK]) for i in range(0, len(rules), _CHUNK)]
    with ThreadPoolExecutor(local_workers()) as pool:
        return list(pool.map(function, chunks))
