"""Convert by the two fixed formulas that are no weighted sum: luminance, and the value of HSV."""

from __future__ import annotations

import numpy as np

from colmap_ihe.grey.srgb import XYZ_FROM_RGB, Float32, bands, checked, coded, linear


def cie_y(rgb: Float32) -> Float32:
    """Return Y of CIE XYZ (IEC 61966-2-1), coded again: the grey that has the luminance of the colour.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32 in [0, 1], coded. R = G = B = v gives
    v. Raises ValueError for another shape or dtype.
    """
    checked(rgb)
    grey = np.empty(rgb.shape[:2], np.float32)
    weights = XYZ_FROM_RGB[1].astype(np.float32)
    for rows in bands(rgb):
        grey[rows] = np.minimum(coded(linear(rgb[rows]) @ weights), np.float32(1))
    return grey


def value(rgb: Float32) -> Float32:
    """Return max(R, G, B), the V of HSV (Smith 1978): (H, W, 3) float32 in, (H, W) float32 out, both in [0, 1]. Raises
    ValueError for another shape or dtype."""
    checked(rgb)
    return np.maximum(np.maximum(rgb[..., 0], rgb[..., 1]), rgb[..., 2])
