"""Equalise the set's grey: one curve from full depth to 8 bit, from the histogram of all photographs.

Every level then holds about as many pixels of the set as any other (Gonzalez and Woods, Digital Image
Processing, 3.3). It is one curve for the set, so the same colour stays the same grey in every photograph.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.boxes import boxes_of
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.weights import DEPTH, LEVELS, Curve

_AT_ONCE = 1 << 20  # cells, which bounds the memory


def curve_of(histogram: Histogram, triplet: tuple[float, float, float]) -> Curve:
    """Return the equalising curve of a linear grey over the set; `Weights.curve` says how it is to be read.

    A value goes to the level `floor(256 (b + e / 2))`, where b is the share of pixels below it and e that of its
    equals, so a value that many pixels share comes to the middle of the levels that they would fill. The histogram
    knows each colour to 1/256 of the square root of each channel: a cell counts as if its greys were spread evenly
    about its middle, with the variance that evenly spread colours have. That puts pixels within a level or
    two of where counting them one by one would. Histograms add exactly, so the curve is the same however
    the set is split. Raises ValueError for a coded or an empty histogram.
    """
    if histogram.encoding != "linear" or not histogram.pixels:
        raise ValueError(f"{histogram.encoding=} {histogram.pixels=}, expected pixels of linear photographs")
    counts = _grey_counts(histogram, triplet)
    below = np.concatenate(([0.0], np.cumsum(counts)))
    middle = (below[:-1] + below[1:]) / 2
    steps = np.arange(1, LEVELS) * (below[-1] / LEVELS)
    return tuple(np.searchsorted(middle, steps, side="left").tolist())


def equalising_table(curve: Curve) -> NDArray[np.uint8]:
    """Return (65536,) uint8: the level of each linear 16-bit value."""
    return np.searchsorted(np.array(curve), np.arange(DEPTH), side="right").astype(np.uint8)


def _grey_counts(histogram: Histogram, triplet: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return the mass at every linear 16-bit grey, (65536,)."""
    boxes = boxes_of(histogram.occupied(), 0)
    shares = np.array(triplet) / sum(triplet)
    change = np.zeros(DEPTH + 1)
    for first in range(0, len(boxes), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        low, high = boxes.low[:, some].astype(np.float64), boxes.high[:, some].astype(np.float64)
        middle, square = np.zeros(low.shape[1]), np.zeros(low.shape[1])
        for share, a, b in zip(shares, low, high, strict=True):  # in order: sums are always the same
            middle += share * (a + b) / 2
            square += (share * (b - a)) ** 2
        half = np.sqrt(square) / 2
        least = np.clip(np.rint(middle - half), 0, DEPTH - 1).astype(np.int64)
        most = np.clip(np.rint(middle + half), 0, DEPTH - 1).astype(np.int64)
        each = boxes.mass[some].astype(np.float64) / (most - least + 1)
        change += np.bincount(least, each, DEPTH + 1) - np.bincount(most + 1, each, DEPTH + 1)
    return np.maximum(np.cumsum(change[:-1]), 0)
