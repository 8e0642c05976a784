"""Convert coded sRGB to what the conversions need: bands of rows, linear light, CIE L*a*b*.

IEC 61966-2-1 (sRGB, D65) and CIE 15 (L*a*b*). "Coded" is gamma-coded as stored in a JPEG, "linear" is
proportional to light; both lie in [0, 1].
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

XYZ_FROM_RGB: NDArray[np.float64] = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
"""Linear sRGB to XYZ, white at Y = 1."""

WHITE: NDArray[np.float64] = XYZ_FROM_RGB.sum(axis=1)

_BAND = 1 << 18
_EPSILON = (6 / 29) ** 3
_KAPPA = (29 / 3) ** 3


def checked(rgb: NDArray[Any]) -> Float32:
    """Return rgb itself. Raises ValueError unless it is (H, W, 3) float32 with at least one pixel."""
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.float32 or not rgb.size:
        raise ValueError(f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) float32 in [0, 1]")
    return rgb


def bands(rgb: Float32) -> Iterator[slice]:
    """Yield rows in bands of about 2^18 pixels, so that what is computed of them stays small beside the image."""
    rows = max(1, _BAND // rgb.shape[1])
    for top in range(0, rgb.shape[0], rows):
        yield slice(top, top + rows)


def rounded(rgb: Float32) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8: the nearest of 256 codes; exact where rgb came from 8 bit."""
    codes = np.empty(rgb.shape, np.uint8)
    for rows in bands(rgb):
        codes[rows] = np.clip(rgb[rows], 0, 1) * np.float32(255) + np.float32(0.5)
    return codes


def linear(coded: Float32) -> Float32:
    """Return linear light of coded sRGB, any shape."""
    high = ((coded + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(coded <= np.float32(0.04045), coded / np.float32(12.92), high)


def coded(light: Float32) -> Float32:
    """Return coded sRGB of linear light, any shape; light below 0 counts as 0."""
    light = np.maximum(light, np.float32(0))
    high = np.float32(1.055) * light ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(light <= np.float32(0.0031308), light * np.float32(12.92), high)


def lightness(y: Float32) -> Float32:
    """Return CIE L* in 0..100 of luminance Y with white at 1, any shape."""
    return np.float32(116) * _f(y) - np.float32(16)


def grey_of_lightness(star: Float32) -> Float32:
    """Return the coded grey in [0, 1] that has this L*; outside 0..100 it is clipped. Any shape."""
    star = np.clip(star, np.float32(0), np.float32(100))
    high = ((star + np.float32(16)) / np.float32(116)) ** 3
    return np.minimum(coded(np.where(star <= 8, star / np.float32(_KAPPA), high)), np.float32(1))


def lab(rgb: Float32) -> Float32:
    """Return CIE L*a*b* (D65) of coded sRGB: (..., 3) float32 in and out; L* in 0..100."""
    xyz = linear(rgb) @ np.asarray((XYZ_FROM_RGB / WHITE[:, None]).T, np.float32)
    x, y, z = (_f(xyz[..., c]) for c in range(3))
    star = np.float32(116) * y - np.float32(16)
    return np.stack([star, np.float32(500) * (x - y), np.float32(200) * (y - z)], axis=-1)


def _f(share: Float32) -> Float32:
    low = np.float32(_KAPPA / 116) * share + np.float32(16 / 116)
    return np.where(share > np.float32(_EPSILON), np.cbrt(share), low)
