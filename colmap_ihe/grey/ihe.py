"""Intensity Histogram Equalisation: the weights whose grey histogram over the set is flattest.

After "Intensity histogram equalisation, a colour-to-grey conversion strategy improving
photogrammetric reconstruction of urban architectural heritage" (2016), equations 4 to 6. With y the
share of pixels in each of 256 grey levels and beta = 1/256 its mean, S = sum (y - beta)^2 = sum y^2 -
beta, so the least S is the least sum of squared counts, Q.

The search counts few of the 5,151 triplets in full. Of a coded set a triplet is left out only where a
bound of its Q is above the Q of one that has been counted, so the winner is proven. Of a linear set,
whose colours are too many to keep, triplets are left out by estimates at rising resolution, each time
with a margin taken from how far they were off for those looked at more closely; the rest is counted
from the photographs at full depth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.boxes import (
    LEVELS,
    Boxes,
    Triplet,
    bound,
    counts_of,
    estimate,
    levels_of,
    merge,
    weighted_sums,
)
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.weights import FIXED, Weights, triplets

WHITE_PERCENTILE = 99.8
"""Of a linear grey; the share of pixels at or below the white point of the set, in percent."""

Recount = Callable[[Sequence[Triplet], Sequence[int]], NDArray[np.int64]]
"""Counts the grey levels of n triplets, with their white points, over the whole set: (n, 256) int64."""

_Counted = dict[Triplet, NDArray[np.int64]]

_SLACK = 1 - 1e-9  # bounds are floating point, Q is not
_SMALL = 600_000  # pixels for which counting all triplets takes seconds
_PROBES, _LAST, _MARGIN = 32, 128, 2.0
_SATURATION = 65535
_CORNER = 97
_BAND = 1 << 16
_WHITE_SHIFT = 6
_WHITE_SIDE = 4


def fit_weights(
    images: Sequence[NDArray[np.uint8]] | Sequence[NDArray[np.uint16]], step: float = 0.01
) -> Weights:
    """The IHE weights of a set of images in memory, every pixel counted.

    images: (H, W, 3) each; all uint8 gamma-coded, or all uint16 linear with 65535 at sensor saturation.
    Raises ValueError for another shape or dtype, a mixed or an empty set.
    """
    if not len(images):
        raise ValueError("no images, expected at least one")
    histogram = Histogram("linear" if images[0].dtype == np.uint16 else "coded")
    for rgb in images:
        histogram.add(rgb)

    def recount(chosen: Sequence[Triplet], whites: Sequence[int]) -> NDArray[np.int64]:
        return np.asarray(sum(count_levels(rgb, chosen, whites) for rgb in images), np.int64)

    return fit_histogram(histogram, step, recount if histogram.encoding == "linear" else None)


def fit_histogram(
    histogram: Histogram,
    step: float = 0.01,
    recount: Recount | None = None,
    advance: Callable[[int], None] = lambda _count: None,
    *,
    exact: bool = False,
) -> Weights:
    """The IHE weights of a set, as by a loop over every triplet and every pixel.

    Coded sets need nothing but their histogram. Linear sets need `recount` too; `exact` has it count every
    triplet, else the most promising ones, which on large sets may miss a winner of nearly the same S.
    Ties go to more occupied tones, then to the nearest to Rec.709, then to the first. `advance(n)` is told
    of every n triplets settled. Raises ValueError for an empty histogram, or a linear one without `recount`.
    """
    if not histogram.pixels:
        raise ValueError("the histogram is empty, expected at least one pixel")
    grid = triplets(step)
    if histogram.encoding == "coded":
        return _best(histogram, _search_coded(histogram, grid, advance), None)
    if recount is None:
        raise ValueError("a linear histogram needs `recount`: its cells are wider than one value")
    boxes = merge(histogram.cells(), _WHITE_SIDE)
    white = {t: _white_of(boxes, t) for t in grid}
    return _best(histogram, _search_linear(histogram, grid, white, recount, advance, exact), white)


def _search_coded(histogram: Histogram, grid: list[Triplet], advance: Callable[[int], None]) -> _Counted:
    cells = histogram.cells()
    whole = merge(cells, 1)
    counted: _Counted = {}
    mark = float("inf")
    alive = grid
    for side in (8, 4, 2):
        boxes = merge(cells, side)
        bounds = {t: bound(boxes, t, None) for t in alive}
        best = min(alive, key=bounds.__getitem__)
        counted[best] = counts_of(whole, best)
        mark = min(mark, _squares(counted[best]))
        survivors = [t for t in alive if bounds[t] * _SLACK <= mark]
        advance(len(alive) - len(survivors))
        alive = survivors
    for triplet in alive:
        counted[triplet] = counts_of(whole, triplet)
        advance(1)
    return counted


def _search_linear(
    histogram: Histogram,
    grid: list[Triplet],
    white: dict[Triplet, int],
    recount: Recount,
    advance: Callable[[int], None],
    exact: bool,
) -> _Counted:
    cells = histogram.cells()
    counted: _Counted = {}

    def in_full(chosen: list[Triplet]) -> dict[Triplet, float]:
        fresh = [t for t in chosen if t not in counted]
        if fresh:
            counted.update(zip(fresh, recount(fresh, [white[t] for t in fresh]), strict=True))
        return {t: float(_squares(counted[t])) for t in chosen}

    if exact or histogram.pixels <= _SMALL:
        in_full(grid)
        return counted
    coarse = merge(cells, 4)
    value = {t: estimate(coarse, t, white[t]) for t in grid}
    alive = grid
    # Where one channel is nearly all of the grey, a box's levels hang together and the even spread is most
    # wrong: on the demo the winner, pure green, was estimated 0.4 % too high. These are always counted.
    corners = [t for t in grid if max(t) >= _CORNER]
    for side, least in ((2, 1024), (1, 512)):
        boxes = merge(cells, side)
        alive = sorted(alive, key=value.__getitem__)
        probed = {t: estimate(boxes, t, white[t]) for t in _probes(alive)}
        survivors = list(dict.fromkeys(alive[:least] + _promising(alive[least:], value, probed) + corners))
        advance(len(alive) - len(survivors))
        value = {t: probed[t] if t in probed else estimate(boxes, t, white[t]) for t in survivors}
        alive = survivors
    alive = sorted(alive, key=value.__getitem__)
    known = in_full(list(dict.fromkeys(alive[:_LAST] + _probes(alive) + corners)))
    while True:  # until no triplet that is not counted could win, by what the counted ones have shown
        missing = [t for t in _promising(alive, value, known) if t not in known]
        if not missing:
            advance(len(alive))
            return counted
        known |= in_full(missing)


def _probes(ordered: list[Triplet]) -> list[Triplet]:
    """The most promising triplets and some from further down, to see how far estimates are off."""
    return ordered[:_PROBES] + ordered[_PROBES : 16 * _PROBES : _PROBES // 2]


def _promising(
    alive: list[Triplet], value: dict[Triplet, float], finer: dict[Triplet, float]
) -> list[Triplet]:
    """Those whose value, were it as much too high as any probe's and a margin more, could still win."""
    ratios = np.array([finer[t] / value[t] for t in finer])
    lowest = ratios.min() - _MARGIN * ratios.std()
    best = min(finer.values())
    return [t for t in alive if value[t] * lowest <= best]


def count_levels(
    rgb: NDArray[np.uint8] | NDArray[np.uint16], chosen: Sequence[Triplet], whites: Sequence[int | None]
) -> NDArray[np.int64]:
    """Grey histograms of one photograph, (len(chosen), 256) int64, from every pixel at full depth.

    rgb: (H, W, 3) uint8 coded, or uint16 linear with the white point of each triplet.
    """
    counts = np.zeros((len(chosen), LEVELS), np.int64)
    wide = np.uint16 if rgb.dtype == np.uint8 else np.uint32
    for start in range(0, rgb.shape[0] * rgb.shape[1], _BAND):
        band = rgb.reshape(-1, 3)[start : start + _BAND].astype(wide)
        planes = [np.ascontiguousarray(band[:, c]) for c in range(3)]
        for n, (triplet, white) in enumerate(zip(chosen, whites, strict=True)):
            levels = levels_of(weighted_sums(planes, triplet), white)
            counts[n] += np.bincount(levels, minlength=LEVELS)
    return counts


def white_point(histogram: Histogram, triplet: tuple[float, float, float]) -> float:
    """The white point of a linear grey over the set, as a share of saturation, in (0, 1]."""
    hundredths = (round(triplet[0] * 100), round(triplet[1] * 100), round(triplet[2] * 100))
    return min(1.0, _white_of(merge(histogram.cells(), _WHITE_SIDE), hundredths) / (100 * _SATURATION))


def _white_of(boxes: Boxes, triplet: Triplet) -> int:
    """The white point in units of i R + j G + k B, at least 1. Each box counts with its middle: the
    definition, not an approximation of one, for it has to be the same however the set is split."""
    sums = (weighted_sums(boxes.low, triplet) + weighted_sums(boxes.high, triplet)) >> (_WHITE_SHIFT + 1)
    counts = np.bincount(sums, weights=boxes.mass)
    place = np.searchsorted(np.cumsum(counts), WHITE_PERCENTILE / 100 * counts.sum())
    return int(place + 1) << _WHITE_SHIFT


def _squares(counts: NDArray[np.int64]) -> int:
    return sum(int(n) ** 2 for n in counts)


def _best(histogram: Histogram, counted: _Counted, white: dict[Triplet, int] | None) -> Weights:
    """The winner among the triplets counted in full."""

    def rank(triplet: Triplet) -> tuple[int, int, float, Triplet]:
        counts = counted[triplet]
        away = sum((w / 100 - r) ** 2 for w, r in zip(triplet, FIXED["rec709"], strict=True))
        return (_squares(counts), -int(np.count_nonzero(counts)), away, triplet)

    winner = min(counted, key=rank)
    counts = counted[winner]
    red, green, blue = (w / 100 for w in winner)
    return Weights(
        red,
        green,
        blue,
        method="ihe",
        encoding=histogram.encoding,
        score=_squares(counts) / int(counts.sum()) ** 2 - 1 / LEVELS,
        tones=int(np.count_nonzero(counts)),
        white=1.0 if white is None else min(1.0, white[winner] / (100 * _SATURATION)),
        images=histogram.images,
        pixels=histogram.pixels,
    )
