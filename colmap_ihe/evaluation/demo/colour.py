"""Linear colours, and sRGB's coding of them."""

from __future__ import annotations

import numpy as np

from colmap_ihe.evaluation.demo.grid import F32


def mix(first: F32, second: F32, share: F32) -> F32:
    """(H, W, 3): `first` where `share` (H, W) is 0, `second` where it is 1."""
    return np.asarray(first + (second - first) * share[..., None], np.float32)


def colour(red: float, green: float, blue: float) -> F32:
    """(3,): a linear colour from an sRGB-coded one in [0, 1]."""
    return linear(np.array((red, green, blue), np.float32))


def linear(coded: F32) -> F32:
    """Linear light from sRGB-coded values, both in [0, 1], any shape (IEC 61966-2-1)."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4).astype(np.float32)


def coded(light: F32) -> F32:
    """sRGB-coded values from linear light, both in [0, 1], any shape (IEC 61966-2-1)."""
    bright = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, bright).astype(np.float32)
