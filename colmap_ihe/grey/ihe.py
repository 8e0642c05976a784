"""Find the weights whose grey histogram over the set is flattest: Intensity Histogram Equalisation (IHE).

After "Intensity histogram equalisation, a colour-to-grey conversion strategy improving
photogrammetric reconstruction of urban architectural heritage" (2016), equations 4 to 6. With y the
share of pixels in each of 256 grey levels and beta = 1/256 its mean, S = sum (y - beta)^2 = sum y^2 -
beta, so the least S is the least sum of squared counts, Q.

The winner is that of a loop over every triplet and every pixel. Coded sets are counted from their histogram, which
holds every colour; linear ones from the photographs, at full depth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey import kernels
from colmap_ihe.grey.boxes import boxes_of, estimates_of, whites_of
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.equalise import curve_of
from colmap_ihe.grey.histogram import LINEAR_EDGES, Histogram
from colmap_ihe.grey.weights import FIXED, LEVELS, Triplet, Weights, linear_rules, shares, triplets

Recount = Callable[[Sequence[Triplet], Sequence[int]], NDArray[np.int64]]
"""Counts the grey levels of n triplets, with their white points, over the whole set: (n, 256) int64."""

_Counted = dict[Triplet, NDArray[np.int64]]

_SLACK = 1 - 1e-9  # of sums of squares in floating point
_WHITE_BITS = 2
_SATURATION = 65535


def fit_weights(
    images: Sequence[NDArray[np.uint8]] | Sequence[NDArray[np.uint16]],
    step: float = 0.01,
    *,
    guard: Literal["noise", "none"] = "noise",
) -> Weights:
    """Return the IHE weights of a set of images in memory, every pixel counted; among the triplets that `contrast`
    admits, or with guard "none" among all, as in the paper.

    images: (H, W, 3) each; all uint8 gamma-coded, or all uint16 linear with 65535 at sensor saturation.
    Raises ValueError for another shape or dtype, a mixed or an empty set.
    """
    if not len(images):
        raise ValueError("no images, expected at least one")
    histogram = Histogram("linear" if images[0].dtype == np.uint16 else "coded")
    contrast = Contrast(histogram.encoding)
    for rgb in images:
        histogram.add(rgb)
        contrast.add(rgb)
    grid = triplets(step)
    admitted = contrast.admitted(grid) if guard == "noise" else grid

    def recount(chosen: Sequence[Triplet], whites: Sequence[int]) -> NDArray[np.int64]:
        counts = (count_levels(np.asarray(rgb, np.uint16), chosen, whites) for rgb in images)
        return np.asarray(sum(counts), np.int64)

    if histogram.encoding == "coded":
        return fit_histogram(histogram, admitted)
    weights = fit_histogram(histogram, admitted, recount)
    return replace(weights, curve=curve_of(histogram, weights.triplet))


def fit_histogram(histogram: Histogram, grid: Sequence[Triplet], recount: Recount | None = None) -> Weights:
    """Return the IHE weights of a set among the triplets of `grid`, by a loop over all of them and every pixel.

    Coded sets need nothing but their histogram. Linear sets need `recount` too, which is called once.
    Ties go to more occupied tones, then to the nearest to Rec.709, then to the first. Raises ValueError for an
    empty histogram, or a linear one without `recount`.
    """
    if not histogram.pixels:
        raise ValueError("the histogram is empty, expected at least one pixel")
    if histogram.encoding == "coded":
        return _best(histogram, histogram.levels(grid), None)
    if recount is None:
        raise ValueError("a linear histogram needs `recount`: its cells are wider than one value")
    whites = whites_of(boxes_of(histogram.occupied(), _WHITE_BITS), grid)
    counted = dict(zip(grid, recount(grid, whites), strict=True))
    return _best(histogram, counted, dict(zip(grid, whites, strict=True)))


def fit_cells(histogram: Histogram, grid: Sequence[Triplet]) -> Weights:
    """Return the IHE weights by the histogram alone: of a coded set those of `fit_histogram`, of a linear one by
    estimate, the pixels of a cell spread evenly over the levels that it reaches; `tones` is then None."""
    if histogram.encoding == "coded":
        return fit_histogram(histogram, grid)
    if not histogram.pixels:
        raise ValueError("the histogram is empty, expected at least one pixel")
    cells = histogram.occupied()
    alive = list(grid)
    for bits, kept in ((2, 200), (0, 1)):
        whites = whites_of(boxes_of(cells, _WHITE_BITS), alive)
        estimates = estimates_of(boxes_of(cells, bits), linear_rules(alive, whites))
        best = np.argsort(estimates, kind="stable")[:kept]
        alive = [alive[i] for i in best]
    score = float(estimates[best[0]]) / int(cells[1].sum()) ** 2 - 1 / LEVELS
    return _weights(histogram, alive[0], score, _share(whites[best[0]]))


def flatness(histogram: Histogram, triplet: tuple[float, float, float]) -> float:
    """Return how many grey levels weights would fill if they filled them evenly, 1 to 256: 1 / sum y^2, of a linear
    set by estimate and with the set's own white point. The weights are rounded to hundredths."""
    whole = [_hundredths(triplet)]
    cells = histogram.occupied()
    mass = int(cells[1].sum())
    if histogram.encoding == "coded":
        return mass**2 / _squares(histogram.levels(whole)[whole[0]])
    rules = linear_rules(whole, whites_of(boxes_of(cells, _WHITE_BITS), whole))
    return mass**2 / float(estimates_of(boxes_of(cells, 0), rules)[0])


def clipped(histogram: Histogram, weights: Weights) -> float:
    """Return the share of pixels of a linear set that the weights' white point makes white."""
    codes, mass = histogram.colours()
    grey = (LINEAR_EDGES[codes] + LINEAR_EDGES[codes + 1] - 1) / 2 @ np.array(weights.triplet)
    return float(mass[grey >= weights.white * _SATURATION].sum() / mass.sum())


def count_levels(
    linear_rgb: NDArray[np.uint16], chosen: Sequence[Triplet], whites: Sequence[int]
) -> NDArray[np.int64]:
    """Return the grey histograms of one linear photograph, (H, W, 3) uint16, by n triplets with their white points,
    from every pixel at full depth: (n, 256) int64."""
    return kernels.count_pixels(linear_rgb, linear_rules(chosen, whites)).astype(np.int64)


def white_point(histogram: Histogram, triplet: tuple[float, float, float]) -> float:
    """Return the white point of a linear grey over the set, as a share of saturation, in (0, 1]."""
    boxes = boxes_of(histogram.occupied(), _WHITE_BITS)
    return _share(whites_of(boxes, [_hundredths(triplet)])[0])


def _hundredths(triplet: tuple[float, float, float]) -> Triplet:
    red, green = round(100 * triplet[0]), round(100 * triplet[1])
    return red, green, 100 - red - green


def _share(white: int) -> float:
    return min(1.0, white / (100 * _SATURATION))


def _squares(counts: NDArray[np.int64]) -> int:
    return sum(n * n for n in counts.tolist())


def _best(histogram: Histogram, counted: _Counted, white: dict[Triplet, int] | None) -> Weights:
    """Return the winner among the triplets counted in full."""
    rough = (np.array(list(counted.values()), np.float64) ** 2).sum(axis=1)
    close = [t for t, squares in zip(counted, rough, strict=True) if squares * _SLACK <= rough.min()]

    def rank(triplet: Triplet) -> tuple[int, int, float, Triplet]:
        counts = counted[triplet]
        away = sum((w / 100 - r) ** 2 for w, r in zip(triplet, FIXED["rec709"], strict=True))
        return (_squares(counts), -int(np.count_nonzero(counts)), away, triplet)

    winner = min(close, key=rank)
    counts = counted[winner]
    score = _squares(counts) / int(counts.sum()) ** 2 - 1 / LEVELS
    share = 1.0 if white is None else _share(white[winner])
    return _weights(histogram, winner, score, share, int(np.count_nonzero(counts)))


def _weights(
    histogram: Histogram, triplet: Triplet, score: float, white: float, tones: int | None = None
) -> Weights:
    images, pixels = histogram.images, histogram.pixels
    return Weights(*shares(triplet), "ihe", histogram.encoding, score, tones, white, images, pixels)
