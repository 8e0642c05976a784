"""Gains and denoising of a decoded photograph, as its recipe asks for."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.photographs.raw.denoise import denoised
from colmap_ihe.project.recipe import Recipe

_Pixels = NDArray[np.uint8] | NDArray[np.uint16]


def prepared(rgb: _Pixels, recipe: Recipe) -> _Pixels:
    """Return the photograph with `recipe.gains` and `recipe.denoise` applied: (H, W, 3), its own dtype; the same array
    where the recipe asks for neither.

    rgb: (H, W, 3), uint8 gamma-coded, or uint16 linear with 65535 at sensor saturation. Gains multiply the values
    as they are, to the nearest whole one; what exceeds the range is cut to its end, and what was clipped before
    is no longer at the end of it after a gain below 1. Denoising comes after, so that its strength is in
    deviations of the noise that is left. Raises ValueError for another shape or dtype, or gains that are not
    positive and finite.
    """
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) uint8 or uint16")
    gains = np.array(recipe.gains, np.float64)
    if gains.shape != (3,) or not np.isfinite(gains).all() or (gains <= 0).any():
        raise ValueError(f"{recipe.gains=}, expected three positive numbers")
    if (gains != 1).any():
        product = cv2.multiply(rgb, np.append(gains, 1))
        rgb = np.asarray(product, np.uint8) if rgb.dtype == np.uint8 else np.asarray(product, np.uint16)
    return denoised(rgb, recipe.denoise) if recipe.denoise > 0 else rgb
