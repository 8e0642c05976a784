"""Denoising by non-local means, its strength in standard deviations of the noise that a photograph shows.

A pixel becomes the mean of those whose surroundings look like its own (Buades, Coll and Morel, CVPR 2005), as
OpenCV has it. It weighs all differences alike, so noise has to be even over brightness: gamma-coded values are
taken as they are, linear ones as their square root, in which noise of photons is even.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_Pixels = NDArray[np.uint8] | NDArray[np.uint16]

_PATCH, _SEARCH = 5, 13  # pixels a side; 7 and 21 take 2.4 times as long
_STRIP = 512  # rows at once: what bounds the memory
_MARGIN = _PATCH // 2 + 2 * (_SEARCH // 2)
_DEPTH = 65535
_OF_8_BIT = _DEPTH // 255
_BLOCK = 16
_FLATTEST = 0.1
_CLIPPED = (0.002, 0.98)  # shares of the range in which values still vary both ways
_LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_LAPLACIAN_POWER = 36.0  # of its weights
_STRIDE = 2  # demosaicing and halved chroma tie neighbours together; every second pixel is on its own


def denoised(rgb: _Pixels, strength: float) -> _Pixels:
    """The photograph with less noise, (H, W, 3) in its own dtype.

    rgb: (H, W, 3), uint8 gamma-coded or uint16 linear. `strength` is the h of non-local means in standard
    deviations of the noise, each channel's own; 0 gives the same array. The same input gives the same output,
    whatever the number of threads. What is smoothed keeps its mean.
    """
    if strength <= 0:
        return rgb
    even = _even(rgb)
    sigma = noise_of(even)
    if not sigma.any():
        return rgb
    height = np.maximum(strength * sigma, 1.0)
    result = np.empty_like(rgb)
    for top in range(0, len(even), _STRIP):
        first, last = max(0, top - _MARGIN), min(len(even), top + _STRIP + _MARGIN)
        noisy = even[first:last]
        h = [float(v) for v in height]
        smooth = np.asarray(cv2.fastNlMeansDenoising(noisy, h, None, _PATCH, _SEARCH, cv2.NORM_L1), np.uint16)
        back = _linear(noisy, smooth) if rgb.dtype == np.uint16 else _coded(smooth)
        result[top : top + _STRIP] = back[top - first : top - first + _STRIP]
    return result


def noise_of(even: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Standard deviation of the noise of each channel, (3,), of (H, W, 3) uint16 whose noise is even over
    brightness; 0 where nothing can be told.

    By the second difference that a plane or a straight edge leaves at 0 (Immerkaer, CVIU 64, 1996), in the
    flattest tenth of the blocks that are not clipped. Of every second pixel, and of each such quarter of the
    picture by itself: demosaicing leaves some of them with more noise than others.
    """
    phases = [(y, x) for y in range(_STRIDE) for x in range(_STRIDE)]
    found = [_flattest(_squares(even[y::_STRIDE, x::_STRIDE])) for y, x in phases]
    return np.asarray(np.sqrt(np.mean(found, axis=0) / _LAPLACIAN_POWER))


def _flattest(square: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mean of (n, 3) over the flattest blocks that show anything, (3,)."""
    shows = square[(square > 0).all(axis=1)]
    if not len(shows):
        return np.zeros(3)
    roughness = (shows / np.median(shows, axis=0)).sum(axis=1)
    flattest = np.argsort(roughness, kind="stable")[: max(1, int(_FLATTEST * len(shows)))]
    return np.asarray(shows[flattest].mean(axis=0))


def _squares(even: NDArray[np.uint16]) -> NDArray[np.float64]:
    """The mean square of the second difference in each unclipped block, (n, 3)."""
    height, width = (n // _BLOCK * _BLOCK for n in even.shape[:2])
    if not height or not width:
        return np.zeros((0, 3))
    values = np.ascontiguousarray(even[:height, :width], np.float32)
    change = np.asarray(cv2.filter2D(values, -1, _LAPLACIAN))
    size = (width // _BLOCK, height // _BLOCK)
    square = np.asarray(cv2.resize(change * change, size, interpolation=cv2.INTER_AREA), np.float64)
    low, high = (np.sqrt(s) * _DEPTH for s in _CLIPPED)
    inside = ((values > low) & (values < high)).all(axis=2).astype(np.float32)
    whole = cv2.resize(inside, size, interpolation=cv2.INTER_AREA) == 1
    return np.asarray(square[whole].reshape(-1, 3))


def _even(rgb: _Pixels) -> NDArray[np.uint16]:
    """Values over which noise is even, 16 bit."""
    if rgb.dtype == np.uint8:
        return np.asarray(rgb, np.uint16) * np.uint16(_OF_8_BIT)
    return np.asarray(_ROOT[rgb], np.uint16)


def _coded(smooth: NDArray[np.uint16]) -> NDArray[np.uint8]:
    return np.asarray((smooth.astype(np.uint32) + _OF_8_BIT // 2) // _OF_8_BIT, np.uint8)


def _linear(noisy: NDArray[np.uint16], smooth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The mean of a square is the square of the mean and the variance that was taken out."""
    root = smooth.astype(np.float32)
    removed = cv2.blur((noisy.astype(np.float32) - root) ** 2, (_SEARCH, _SEARCH))
    linear = (root * root + removed) * np.float32(1 / _DEPTH)
    return np.asarray(np.minimum(linear + np.float32(0.5), _DEPTH), np.uint16)


_ROOT = np.rint(np.sqrt(np.arange(_DEPTH + 1) * float(_DEPTH))).astype(np.uint16)
