"""Colours gathered into boxes, and what grey levels a box reaches under one triplet.

A box reaches a short run of grey levels; where in the run its pixels fall is not known. Spread evenly
they give an estimate of Q, the sum of squared counts. And they give a bound: for any prices p >= 0 of the
levels, Q = sum n^2 >= sum (2 p n - p^2), and the sum of n p is at least each box's mass times the least
price in its run. With the even spread for prices the bound is close.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.histogram import LINEAR_EDGES, Cells

LEVELS = 256
Triplet = tuple[int, int, int]
"""Weights of red, green and blue in hundredths."""

_Integers = NDArray[Any]
"""uint16 for coded input, which holds 100 x 255; uint32 for linear, which holds 256 x 100 x 65535."""

_ALONE = 4096


@dataclass(frozen=True)
class Boxes:
    """M boxes: planes of their least and greatest R, G, B, each (M,), and their mass (M,) float64."""

    low: list[_Integers]
    high: list[_Integers]
    mass: NDArray[np.float64]


def merge(cells: Cells, side: int) -> Boxes:
    """Cells gathered in cubes of `side` codes. The heaviest stay alone: a spike such as a burnt-out sky is
    most of Q, and a bound that spreads it over two levels is worth nothing."""
    linear = not np.array_equal(cells.low, cells.high)
    codes = (np.searchsorted(LINEAR_EDGES, cells.high, side="right") - 1 if linear else cells.low) // side
    key = (codes[:, 0] * LEVELS + codes[:, 1]) * LEVELS + codes[:, 2]
    alone = np.argsort(cells.mass, kind="stable")[-_ALONE:]
    key[alone] = -1 - np.arange(len(alone))
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=key.min() - 1))
    wide = np.uint32 if linear else np.uint16
    low = np.minimum.reduceat(cells.low[order], starts, axis=0).astype(wide)
    high = np.maximum.reduceat(cells.high[order], starts, axis=0).astype(wide)
    return Boxes(
        [low[:, c].copy() for c in range(3)],
        [high[:, c].copy() for c in range(3)],
        np.add.reduceat(cells.mass[order], starts).astype(np.float64),
    )


def weighted_sums(planes: list[_Integers], triplet: Triplet) -> _Integers:
    """i R + j G + k B of three planes, in their own dtype."""
    kind = planes[0].dtype.type
    total: _Integers = planes[0] * kind(triplet[0])
    scratch = np.empty_like(total)
    for plane, weight in zip(planes[1:], triplet[1:], strict=True):
        np.multiply(plane, kind(weight), out=scratch)
        total += scratch
    return total


def levels_of(sums: _Integers, white: int | None) -> _Integers:
    """Grey levels 0..255 of weighted sums, which are overwritten.

    Coded (`white` None): (sum + 50) // 100, which keeps R = G = B = v at v. Linear: 256 even levels up
    to `white`, everything above in the last.
    """
    kind = sums.dtype.type
    if white is None:
        sums += kind(50)
        sums //= kind(100)
        return sums
    sums *= kind(LEVELS)
    sums //= kind(white)
    return np.asarray(np.minimum(sums, kind(LEVELS - 1), out=sums))


def counts_of(boxes: Boxes, triplet: Triplet) -> NDArray[np.int64]:
    """Grey histogram (256,) of coded boxes of one colour each; exact below a mass of 2^53."""
    levels = levels_of(weighted_sums(boxes.low, triplet), None)
    return np.bincount(levels, weights=boxes.mass, minlength=LEVELS).astype(np.int64)


def estimate(boxes: Boxes, triplet: Triplet, white: int | None) -> float:
    """Q with every box spread evenly over the levels it reaches."""
    price = _spread(_runs(boxes, triplet, white))
    return float(price @ price)


def bound(boxes: Boxes, triplet: Triplet, white: int | None) -> float:
    """A lower bound of Q over all ways in which the pixels of each box may fall in its run."""
    runs = _runs(boxes, triplet, white)
    price = _spread(runs)
    least, value = price.copy(), 0.0
    for extra, mass in enumerate(runs):
        if extra:
            least[:-extra] = np.minimum(least[:-extra], price[extra:])
        value += float(mass @ least)
    return 2 * value - float(price @ price)


def _runs(boxes: Boxes, triplet: Triplet, white: int | None) -> NDArray[np.float64]:
    """(longest, 256): mass of the boxes by the length of their run less one, and its first level."""
    first = levels_of(weighted_sums(boxes.low, triplet), white)
    place = levels_of(weighted_sums(boxes.high, triplet), white)
    place -= first
    longest = int(place.max()) + 1
    place *= place.dtype.type(LEVELS)
    place += first
    mass = np.bincount(place, weights=boxes.mass, minlength=longest * LEVELS)
    return np.asarray(mass.reshape(longest, LEVELS), np.float64)


def _spread(runs: NDArray[np.float64]) -> NDArray[np.float64]:
    price = np.zeros(LEVELS)
    for extra, mass in enumerate(runs):
        for step in range(extra + 1):
            price[step:] += mass[: LEVELS - step] / (extra + 1)
    return price
