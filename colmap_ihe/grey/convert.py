"""Colour to grey with the weights of the set: the same colour is the same grey in every image."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.weights import Weights

Tone = Literal["sqrt", "linear"]
_DEPTH = 65536


def to_grey(
    rgb: NDArray[np.uint8] | NDArray[np.uint16], weights: Weights, tone: Tone = "sqrt"
) -> NDArray[np.uint8]:
    """8-bit grey of one photograph, (H, W) uint8.

    Coded: rgb (H, W, 3) uint8 gives `(i R + j G + k B + 50) // 100` for weights in hundredths, exactly;
    other weights are rounded to the nearest level. R = G = B = v gives v. Linear: rgb (H, W, 3) uint16,
    65535 at saturation, is weighed at full depth, scaled by the set's white point and coded once by
    `tone`: "sqrt" makes photon noise even over the range, "linear" is the paper's "no gamma". Raises
    ValueError where the dtype does not fit the weights' encoding.
    """
    expected = np.uint8 if weights.encoding == "coded" else np.uint16
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != expected:
        raise ValueError(
            f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) {np.dtype(expected)} for {weights.encoding=}"
        )
    hundredths = [round(w * 100) for w in weights.triplet]
    exact = all(abs(w * 100 - h) < 1e-9 for w, h in zip(weights.triplet, hundredths, strict=True))
    if weights.encoding == "coded" and exact:
        wide = rgb.astype(np.uint16)
        total = sum(wide[..., c] * np.uint16(h) for c, h in enumerate(hundredths)) + np.uint16(50)
        return np.asarray(total // np.uint16(100)).astype(np.uint8)
    triplet = np.array(weights.triplet, np.float32) / np.float32(sum(weights.triplet))
    grey = rgb.astype(np.float32) @ triplet + np.float32(0.5)
    if weights.encoding == "coded":
        return np.asarray(grey, np.uint8)
    return np.asarray(tone_table(weights.white, tone)[grey.astype(np.uint16)], np.uint8)


def tone_table(white: float, tone: Tone) -> NDArray[np.uint8]:
    """(65536,) uint8: the 8-bit level of each linear 16-bit value, `white` (share of saturation) at 255."""
    share = np.minimum(np.arange(_DEPTH) / (white * (_DEPTH - 1)), 1.0)
    return np.asarray(np.round(255 * (np.sqrt(share) if tone == "sqrt" else share)), np.uint8)


def to_colour(
    linear_rgb: NDArray[np.uint16], srgb_from_camera: NDArray[np.float64], white: float
) -> NDArray[np.uint8]:
    """The colour twin of a linear photograph: (H, W, 3) uint8 sRGB (IEC 61966-2-1), for eyes only.

    linear_rgb: (H, W, 3) uint16. `white` (share of saturation) becomes 255 in every image of the set.
    """
    matrix = np.asarray(srgb_from_camera / white, np.float32)
    linear = np.clip(linear_rgb.astype(np.float32) @ matrix.T, 0, _DEPTH - 1)
    return np.asarray(_SRGB[linear.astype(np.uint16)], np.uint8)


def _srgb_table() -> NDArray[np.uint8]:
    share = np.arange(_DEPTH) / (_DEPTH - 1)
    coded = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * coded), np.uint8)


_SRGB = _srgb_table()
