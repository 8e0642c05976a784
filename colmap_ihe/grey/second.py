"""Add to the grey of a photograph what only its colours show.

One triplet serves the whole set, and so it serves what fills the photographs; a fresco in two colours that it cannot
tell apart is blank in it. The second grey is another direction in colour, one for the set: weights of any sign. Where
the first shows a small part of the detail that the second shows, the second's is added to it. Both are linear, so the
picture is there a linear grey again, of other weights, in every photograph that sees the place.

Detail and noise are measured as the guard does (grey/contrast.py), in the band where features are found, at a size
that all photographs share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

LARGEST = 1600
"""Pixels of the longer side at which detail is measured, of photographs that are larger."""
_SIGMA, _WIDTH = 1.0, 1.6  # the band, at half that size
_WINDOW = 4.0  # sigma of the window in which it is measured, pixels of the half size
_KEPT = (0.2, 0.35)
"""Of the second's detail: where the first shows the lower share the second counts in full, with the higher not."""
_CLEAR = (1.2, 1.8)
"""Times its noise: below the lower the second has nothing to show, above the higher it has."""
_LEVEL = 64  # of the longer side: coarser brightness than this part of it stays the first grey's

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class SecondGrey:
    """Hold the direction, in levels of 8-bit grey for each level of the 8-bit colours of the twin; its weights need not
    be positive, and their sum is about 0 where it shows colour alone. `noise`, `own_noise`: variance of the first and
    of the second grey in the band, where there is no detail, in levels squared. `name`: of a fixed direction, or
    "fitted"."""

    red: float
    green: float
    blue: float
    noise: float
    own_noise: float
    name: str = "fitted"

    def levels(self, colour: U8) -> F32:
        """Return the second grey of (H, W, 3) uint8 RGB: (H, W) float32, of any sign."""
        weights = np.array((self.red, self.green, self.blue), np.float32)
        return np.asarray(cv2.transform(colour.astype(np.float32), weights[None]), np.float32)

    def shares(self, grey: U8, colour: U8) -> F32:
        """Return (H, W) float32, from 0 where the first grey (H, W) shows the detail to 1 where only the second does.
        Raises ValueError for a twin of another size."""
        if colour.shape != (*grey.shape, 3):
            raise ValueError(f"{colour.shape=}, expected {(*grey.shape, 3)}")
        own = np.sqrt(_variance(self.levels(shrunk(colour))) / np.float32(self.own_noise))
        first = np.sqrt(_variance(shrunk(grey).astype(np.float32)) / np.float32(self.noise))
        kept = first / np.maximum(own, np.float32(1e-6))
        small = cv2.dilate(_step(own, *_CLEAR) * (1 - _step(kept, *_KEPT)), np.ones((5, 5), np.uint8))
        soft = cv2.GaussianBlur(small, (0, 0), _WINDOW)
        return np.asarray(cv2.resize(soft, grey.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)

    def combined(self, grey: U8, colour: U8) -> tuple[U8, F32]:
        """Return the grey with what the second adds to it, (H, W) uint8, and `shares`; the grey itself where it shows
        all. Raises as `shares`."""
        shares = self.shares(grey, colour)
        if not shares.any():
            return grey, shares
        levels = self.levels(colour)
        levels -= _blurred(levels, max(grey.shape) / _LEVEL)
        return np.clip(np.rint(grey + shares * levels), 0, 255).astype(np.uint8), shares


def shrunk(picture: U8) -> U8:
    """Return the picture with `LARGEST` pixels along its longer side at the most, each the average over its area."""
    scale = LARGEST / max(picture.shape[:2])
    if scale >= 1:
        return picture
    size = [max(2, round(n * scale)) for n in picture.shape[1::-1]]
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def band(picture: NDArray[Any]) -> F32:
    """Return the band of detail of (H, W) or (H, W, C), at half its size: float32."""
    size = [max(1, n // 2) for n in picture.shape[1::-1]]
    half = cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    fine, coarse = (cv2.GaussianBlur(half, (0, 0), sigma) for sigma in (_SIGMA, _SIGMA * _WIDTH))
    return np.asarray(fine - coarse, np.float32)


def _variance(levels: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(np.square(band(levels)), (0, 0), _WINDOW), np.float32)


def _step(values: F32, low: float, high: float) -> F32:
    """Return 0 up to `low`, 1 from `high` on, smoothly between."""
    share = np.clip((values - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share), np.float32)


def _blurred(levels: F32, sigma: float) -> F32:
    """Return (H, W) float32 blurred by a Gaussian of so many pixels, on a smaller copy: it is as smooth."""
    factor = max(1, int(sigma / 6))
    size = [max(1, n // factor) for n in levels.shape[::-1]]
    small = cv2.resize(levels, size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma / factor)
    return np.asarray(cv2.resize(small, levels.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
