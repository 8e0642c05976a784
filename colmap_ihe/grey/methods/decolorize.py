"""Add to luminance a fixed share of the chrominance that luminance shows least (decolorize).

After Grundland and Dodgson, "Decolorize: fast, contrast enhancing, color to grayscale conversion",
Pattern Recognition 40 (2007). Over a set, as in Benedetti et al., "Multi-image decolorize" (2012), axis and
quantiles come from all photographs, so that the same colour is the same grey in all of them.

One pass over the set is enough. The axis is a sum over pairs of pixels, kept as whole numbers; the
quantiles follow from the axis and from how many pixels have each colour, in 256 codes a channel. Whole
numbers add in any order and grouping to the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.srgb import Float32, bands, checked, rounded

EFFECT = 0.5
"""How much chrominance is added, as a share."""

NOISE = 0.001
"""The share of pixels, at either end, that is taken for outliers."""

Parameters = tuple[float, float, float, float, float, float, float]
"""Axis in P and Q, of length 1 or 0; the quantile of |projection|; the range of tones before the stretch
(low, high) and after it (low, high)."""

_YPQ: NDArray[np.float64] = np.array([[0.298936, 0.587043, 0.114021], [0.5, 0.5, -1.0], [1.0, -1.0, 0.0]])
_LEAST_CONTRAST = 0.668568  # of luminance, where that of RGB is 1
_MOST_CHROMA = 1.118034
_TINY = 1e-10
_SEED = 2007
_UNIT = 1 << 32  # of the fixed-point sums


class DecolorizeSet:
    """Gather what `decolorize` has to know of a set: 128 MiB, however many photographs are added."""

    def __init__(self) -> None:
        self.colours = Histogram("coded")
        self.axis = (0, 0)

    def add(self, rgb: Float32) -> None:
        """Count one photograph, (H, W, 3) float32 in [0, 1], coded; each pixel is paired with another of it. Raises
        ValueError for another shape or dtype."""
        self.colours.add(rounded(checked(rgb)))
        p, q = _contrast_lost(rgb)
        self.axis = (self.axis[0] + p, self.axis[1] + q)

    def __add__(self, other: DecolorizeSet) -> DecolorizeSet:
        total = DecolorizeSet()
        total.colours = self.colours + other.colours
        total.axis = (self.axis[0] + other.axis[0], self.axis[1] + other.axis[1])
        return total

    def finish(self) -> Parameters:
        """Return the parameters of the set. Raises ValueError for a set without photographs."""
        if not self.colours.pixels:
            raise ValueError("no photographs were added, expected at least one")
        length = math.hypot(*self.axis)
        p, q = (a / length if length else 0.0 for a in self.axis)
        codes, mass = self.colours.colours()
        ypq = (codes / 255) @ _YPQ.T
        projected = ypq[:, 1:] @ np.array([p, q])
        (reach,) = quantiles(np.abs(projected), mass, [1 - NOISE])
        tones = ypq[:, 0] + EFFECT * projected / (reach or 1.0)
        low, high = quantiles(tones, mass, [NOISE, 1 - NOISE])
        dark, bright = quantiles(ypq[:, 0], mass, [NOISE, 1 - NOISE])
        target = (1 - EFFECT) * dark, EFFECT + (1 - EFFECT) * bright
        return (p, q, reach, low, high, *target)


def decolorize(rgb: Float32) -> Float32:
    """Return the grey of one photograph with axis and quantiles of its own, which breaks colour consistency.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32 in [0, 1]. R = G = B = v gives v.
    Raises ValueError for another shape or dtype.
    """
    fitted = DecolorizeSet()
    fitted.add(rgb)
    return apply_decolorize(rgb, fitted.finish())


def apply_decolorize(rgb: Float32, parameters: Parameters) -> Float32:
    """Return the grey of one photograph with the parameters of its set; shapes and errors as `decolorize`."""
    checked(rgb)
    p, q, reach, low, high, dark, bright = parameters
    gain = (bright - dark) / (high - low) if high > low else 1.0
    grey = np.empty(rgb.shape[:2], np.float32)
    for rows in bands(rgb):
        y, across, along = np.moveaxis(rgb[rows] @ _YPQ.T.astype(np.float32), -1, 0)
        tone = y + np.float32(EFFECT / (reach or 1.0)) * (np.float32(p) * across + np.float32(q) * along)
        tone = (tone - np.float32(low)) * np.float32(gain) + np.float32(dark)
        room = np.float32(EFFECT / _MOST_CHROMA) * np.hypot(across, along)
        grey[rows] = np.clip(np.clip(tone, y - room, y + room), 0, 1)
    return grey


def quantiles(values: NDArray[np.float64], mass: NDArray[np.int64], shares: list[float]) -> list[float]:
    """Return for each share the least of `values` (M,) at or below which that share of the `mass` (M,) lies."""
    order = np.argsort(values, kind="stable")
    upto = np.cumsum(mass[order])
    return [float(values[order[np.searchsorted(upto, share * upto[-1])]]) for share in shares]


def _contrast_lost(rgb: Float32) -> tuple[int, int]:
    """Return the sum over pairs of (dP, dQ), turned towards the brighter, weighed by the contrast luminance loses."""
    height, width = rgb.shape[:2]
    p = q = 0
    for rows, there in _partners(height, width):
        difference = rgb[rows].reshape(-1, 3) - np.take(rgb.reshape(-1, 3), there, axis=0)
        red, green, blue = np.ascontiguousarray(difference.T, np.float64)
        dy, dp, dq = (row[0] * red + row[1] * green + row[2] * blue for row in _YPQ)
        contrast = np.sqrt(red * red + green * green + blue * blue) + _TINY
        weight = (1 - np.abs(dy) / _LEAST_CONTRAST / contrast) * np.sign(dy)
        p += round(float((weight * dp).sum()) * _UNIT)
        q += round(float((weight * dq).sum()) * _UNIT)
    return p, q


def _partners(height: int, width: int) -> Iterator[tuple[slice, NDArray[np.int64]]]:
    """Yield bands of rows, and for each pixel the index of its partner: some way off, mirrored at the borders."""
    rng = np.random.default_rng(_SEED)
    spread = np.sqrt(2 * min(height, width)) * np.sqrt(2 / np.pi)
    band = max(1, (1 << 16) // width)
    for top in range(0, height, band):
        rows = np.arange(top, min(top + band, height))
        away = np.rint(spread * rng.standard_normal((2, len(rows), width))).astype(np.int64)
        row = _mirrored(rows[:, None] + away[0], height)
        column = _mirrored(np.arange(width) + away[1], width)
        yield slice(top, top + band), (row * width + column).reshape(-1)


def _mirrored(index: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    index = index % (2 * size)
    return np.minimum(index, 2 * size - 1 - index)
