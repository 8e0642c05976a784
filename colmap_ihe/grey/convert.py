"""Convert colour to grey with the weights of the set: the same colour is the same grey in every image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import WeightsError
from colmap_ihe.grey import kernels
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.equalise import equalising_table
from colmap_ihe.grey.weights import DEPTH, Formula, Grey, Weights, parts_rule

Tone = Literal["sqrt", "linear", "equalise"]
TONES: tuple[Tone, ...] = ("sqrt", "linear", "equalise")
_PARTS = (100, 3, 10_000, 9_999)
"""What weights are whole parts of: those of a fit, of the mean, of Rec.709, and MATLAB's, which sum to .9999."""


def to_grey(
    rgb: NDArray[np.uint8] | NDArray[np.uint16], grey: Grey, tone: Tone = "sqrt"
) -> NDArray[np.uint8]:
    """Return the 8-bit grey of one photograph, (H, W) uint8.

    Coded: rgb (H, W, 3) uint8 gives `(i R + j G + k B + 50) // 100` for weights in hundredths, exactly;
    other weights are rounded to the nearest level, halves up. R = G = B = v gives v. Linear: rgb (H, W, 3)
    uint16, 65535 at saturation, is weighed at full depth and coded once by `tone`: scaled by the set's white
    point, "sqrt" makes photon noise even over the range, and "linear" is the paper's "no gamma"; "equalise" is the
    curve that the weights hold, by which every level has as many pixels of the set. A `Formula` takes coded
    values: of a linear photograph those that `tone` gives each channel. Raises ValueError where the dtype does
    not fit the encoding, `WeightsError` as `check_tone`.
    """
    expected = np.uint8 if grey.encoding == "coded" else np.uint16
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != expected:
        raise ValueError(
            f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) {np.dtype(expected)} for {grey.encoding=}"
        )
    check_tone(grey, tone)
    if isinstance(grey, Formula):
        return _by_formula(coded_share(rgb, grey.white, tone), grey)
    triplet = np.array(grey.triplet) / sum(grey.triplet)
    if grey.encoding == "linear":
        sums = rgb.astype(np.float32) @ triplet.astype(np.float32) + np.float32(0.5)
        table = equalising_table(grey.curve) if tone == "equalise" else tone_table(grey.white, tone)
        return np.asarray(table[sums.astype(np.uint16)], np.uint8)
    for parts in _PARTS:
        rule = parts_rule(triplet * parts, parts)
        if rule is not None:
            return kernels.weigh(np.asarray(rgb, np.uint8), rule)
    return np.asarray(rgb.astype(np.float32) @ triplet.astype(np.float32) + np.float32(0.5), np.uint8)


def check_tone(grey: Grey, tone: Tone) -> None:
    """Raise `WeightsError` for "equalise" of linear photographs with a grey that holds no curve for it."""
    if tone != "equalise" or grey.encoding == "coded" or (isinstance(grey, Weights) and grey.curve):
        return
    if isinstance(grey, Formula):
        raise WeightsError(
            f"tone equalise is for weights, and {grey.method} is no triplet of them",
            hint="use another tone or another method",
        )
    raise WeightsError(
        "the weights hold no curve for tone equalise",
        hint="fit them again on RAW photographs with `colmap-ihe fit`, or use another tone",
    )


def coded_share(
    rgb: NDArray[np.uint8] | NDArray[np.uint16], white: float = 1.0, tone: Tone = "sqrt"
) -> NDArray[np.float32]:
    """Return coded values in [0, 1], (H, W, 3) float32: of a coded photograph its own, of a linear one those that
    `tone` gives each channel with `white` (share of saturation) at 1."""
    if rgb.dtype == np.uint8:
        return np.multiply(rgb, np.float32(1 / 255), dtype=np.float32)
    return np.asarray(_toned(white, tone), np.float32)[rgb]


def _by_formula(rgb: NDArray[np.float32], formula: Formula) -> NDArray[np.uint8]:
    conversion = CONVERSIONS[formula.method]
    if conversion.apply is not None:
        grey = conversion.apply(rgb, formula.parameters)
    elif conversion.convert is not None:
        grey = conversion.convert(rgb)
    else:
        raise ValueError(f"{formula.method=}, expected a conversion that is no triplet")
    return np.asarray(np.clip(grey, 0, 1) * np.float32(255) + np.float32(0.5), np.uint8)


def tone_table(white: float, tone: Tone) -> NDArray[np.uint8]:
    """Return (65536,) uint8: the 8-bit level of each linear 16-bit value, `white` (share of saturation) at 255. `tone`
    is "sqrt" or "linear", else ValueError: equalising takes a curve, not a white point."""
    if tone == "equalise":
        raise ValueError(f"{tone=}, expected 'sqrt' or 'linear'")
    return np.asarray(np.round(255 * _toned(white, tone)), np.uint8)


def _toned(white: float, tone: Tone) -> NDArray[np.float64]:
    share = np.minimum(np.arange(DEPTH) / (white * (DEPTH - 1)), 1.0)
    return np.sqrt(share) if tone == "sqrt" else share


def to_colour(
    linear_rgb: NDArray[np.uint16],
    srgb_from_camera: NDArray[np.float64],
    white: float,
    gains: Sequence[float] = (1.0, 1.0, 1.0),
) -> NDArray[np.uint8]:
    """Return the colour twin of a linear photograph: (H, W, 3) uint8 sRGB (IEC 61966-2-1), for eyes only.

    linear_rgb: (H, W, 3) uint16, multiplied by `gains` before. `srgb_from_camera`: (3, 3), a white balance and then a
    matrix whose rows sum to 1. `white` (share of saturation) becomes 255 in every image of the set. Balanced channels
    are cut where the first of them saturates, so that what is blown out is white and has no colour of its own.
    """
    balance = 1 / np.linalg.solve(srgb_from_camera, np.ones(3))  # the inverse of what becomes white
    white = min(white, float(balance.min()))
    cut = min(white, float((balance * np.minimum(gains, 1)).min()))
    balanced = np.minimum(linear_rgb * balance.astype(np.float32), np.float32(cut * (DEPTH - 1)))
    matrix = np.asarray(srgb_from_camera / balance / white, np.float32)
    linear = np.clip(balanced @ matrix.T, 0, DEPTH - 1)
    return np.asarray(_SRGB[linear.astype(np.uint16)], np.uint8)


def _srgb_table() -> NDArray[np.uint8]:
    share = np.arange(DEPTH) / (DEPTH - 1)
    coded = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * coded), np.uint8)


_SRGB = _srgb_table()
