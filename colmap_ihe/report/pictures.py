"""Make the pictures of a page, coded to be looked at: arrays in, `Picture`s out."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from colmap_ihe.grey.weights import FIXED
from colmap_ihe.report.contents import Picture

U8 = NDArray[np.uint8]

_QUALITY = 85
_DRAWN = 250  # matches of a pair; more of them hide the photographs
_GAP = 8  # pixels between two photographs side by side
_PALE = 0.35  # of what is left of the colours beside a mark
_MARK = (230.0, 80.0, 0.0)
_MIDDLE = 127  # of a picture of differences: no difference


def picture(pixels: U8, alt: str, longest: int) -> Picture:
    """Code (H, W) or (H, W, 3) uint8 sRGB as JPEG, shrunk until its longer side is at most `longest`."""
    pixels = shrunk(pixels, longest)
    coded = simplejpeg.encode_jpeg(
        np.ascontiguousarray(pixels if pixels.ndim == 3 else pixels[..., None]),
        quality=_QUALITY,
        colorspace="RGB" if pixels.ndim == 3 else "GRAY",
        colorsubsampling="420" if pixels.ndim == 3 else "Gray",
    )
    return Picture(coded, pixels.shape[1], pixels.shape[0], alt)


def shrunk(pixels: U8, longest: int) -> U8:
    """Return `pixels` with their longer side at most `longest`; each pixel is the mean over its area."""
    scale = longest / max(pixels.shape[:2])
    if scale >= 1:
        return pixels
    size = [max(1, round(n * scale)) for n in pixels.shape[1::-1]]
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def rec709(rgb: U8) -> U8:
    """Return (H, W) uint8: the grey that COLMAP makes of (H, W, 3) uint8 by default."""
    return np.asarray(np.rint(rgb @ np.array(FIXED["rec709"], np.float32)), np.uint8)


def difference(chosen: U8, default: U8) -> U8:
    """Return (H, W) uint8: the difference of two greys, `_MIDDLE` where there is none."""
    return np.asarray(np.clip(chosen.astype(np.int16) - default + _MIDDLE, 0, 255), np.uint8)


def marked(rgb: U8, places: NDArray[np.bool_]) -> U8:
    """Return (H, W, 3) uint8: a photograph, paler, with places (h, w) of it marked in full colour."""
    mask = cv2.resize(places.astype(np.float32), rgb.shape[1::-1], interpolation=cv2.INTER_NEAREST)[..., None]
    pale = 255 - (255 - rgb.astype(np.float32)) * _PALE
    return np.asarray(np.rint(pale * (1 - mask) + mask * (0.5 * rgb + 0.5 * np.array(_MARK))), np.uint8)


def patchwork(pixels: Sequence[U8], side: int) -> U8:
    """Lay the middle squares of photographs, all (h, w) or all (h, w, 3), as tiles of `side` pixels in a square."""
    across = int(np.ceil(len(pixels) ** 0.5))
    down = -(-len(pixels) // across)
    whole = np.full((down * side, across * side, *pixels[0].shape[2:]), 255, np.uint8)
    for number, photograph in enumerate(pixels):
        height, width = photograph.shape[:2]
        edge = min(height, width)
        square = photograph[(height - edge) // 2 :][:edge, (width - edge) // 2 :][:, :edge]
        y, x = (n * side for n in divmod(number, across))
        whole[y : y + side, x : x + side] = cv2.resize(square, (side, side), interpolation=cv2.INTER_AREA)
    return whole


def matches_drawn(first: U8, second: U8, starts: NDArray[np.float64], ends: NDArray[np.float64]) -> U8:
    """Return (H, W, 3) uint8: two greys side by side, with lines between (N, 2) points that match, in pixels of each.

    Of many matches some are drawn, spread over all; colours only tell neighbours apart.
    """
    height = max(len(first), len(second))
    shift = first.shape[1] + _GAP
    canvas = np.full((height, shift + second.shape[1]), 255, np.uint8)
    canvas[: len(first), : first.shape[1]] = first
    canvas[: len(second), shift:] = second
    drawn = cv2.cvtColor(canvas, cv2.COLOR_GRAY2RGB)
    order = np.lexsort((starts[:, 1], starts[:, 0]))
    chosen = order[np.unique(np.linspace(0, len(order) - 1, min(_DRAWN, len(order))).astype(int))]
    for number, row in enumerate(chosen):
        colour = [round(255 * c) for c in colorsys.hsv_to_rgb(number * 0.618 % 1, 0.75, 1.0)]
        start, end = np.rint(starts[row]).astype(int), np.rint(ends[row] + (shift, 0)).astype(int)
        cv2.line(drawn, tuple(start.tolist()), tuple(end.tolist()), colour, 1, cv2.LINE_AA)
    return np.asarray(drawn, np.uint8)
