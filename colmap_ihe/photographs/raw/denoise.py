"""Denoising by soft thresholds on wavelets, the strength in standard deviations of the noise that is found.

BayesShrink (Chang, Yu and Vetterli, IEEE Transactions on Image Processing 9, 2000): in every subband of the wavelet
transform, noise of variance v on detail of standard deviation d is thresholded at v / d. It takes noise to be
even over brightness, so gamma-coded values are taken as they are and linear ones as their square root, in
which the noise of photons is even.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import CapabilityError

_Pixels = NDArray[np.uint8] | NDArray[np.uint16]

_WAVELET, _LEVELS = "db2", 4
_STRIP = 1024  # rows at once, which bounds the memory; a multiple of 2^_LEVELS, so that all see the same grid
_MARGIN = 64  # rows that the coarsest wavelet reaches, and more
_REMOVED = 9  # pixels a side over which removed noise is averaged
_DEPTH = 65535
_OF_8_BIT = _DEPTH // 255
_BLOCK = 16
_FLATTEST = 0.1
_CLIPPED = (0.002, 0.98)  # shares of the range in which values still vary both ways
_LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_LAPLACIAN_POWER = 36.0  # of its weights
_STRIDE = 2  # demosaicing and halved chroma tie neighbours together; every second pixel is on its own


def require_wavelets() -> Any:
    """Return PyWavelets. Raises `CapabilityError` where it is not installed."""
    try:
        import pywt
    except ImportError as error:
        raise CapabilityError(
            "denoising needs PyWavelets, which is not installed",
            hint="in the clone of colmap-ihe: pip install '.[denoise]'; or leave develop.denoise at 0",
        ) from error
    return pywt


def denoised(rgb: _Pixels, strength: float) -> _Pixels:
    """Return the photograph with less noise, (H, W, 3) in its own dtype.

    rgb: (H, W, 3), uint8 gamma-coded or uint16 linear. `strength` multiplies the standard deviation of the noise
    that is found, each channel's own: 1 is BayesShrink as it was meant, 0 gives the same array, and so does a
    photograph of which no noise is known. What is smoothed keeps its mean. The same input gives the same output.
    Raises `CapabilityError` where PyWavelets is not installed.
    """
    if strength <= 0:
        return rgb
    wavelets = require_wavelets()
    even = _even(rgb)
    sigma = strength * noise_of(even)
    if not sigma.any():
        return rgb
    result = np.empty_like(rgb)
    for top in range(0, len(even), _STRIP):
        first, last = max(0, top - _MARGIN), min(len(even), top + _STRIP + _MARGIN)
        inside = slice(top - first, top - first + _STRIP)
        for channel in range(3):
            noisy = np.ascontiguousarray(even[first:last, :, channel], np.float32)
            smooth = _shrunk(wavelets, noisy, float(sigma[channel]))
            back = _linear(noisy, smooth) if rgb.dtype == np.uint16 else smooth * np.float32(1 / _OF_8_BIT)
            whole = np.clip(np.rint(back[inside]), 0, np.iinfo(rgb.dtype).max)
            result[top : top + _STRIP, :, channel] = whole
    return result


def _shrunk(wavelets: Any, noisy: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return (H, W) without its noise of this standard deviation."""
    coarse, *details = wavelets.wavedec2(noisy, _WAVELET, mode="symmetric", level=_LEVELS)
    kept = [tuple(_thresholded(band, sigma**2) for band in bands) for bands in details]
    smooth = wavelets.waverec2([coarse, *kept], _WAVELET, mode="symmetric")
    return np.asarray(smooth[: noisy.shape[0], : noisy.shape[1]], np.float32)


def _thresholded(band: NDArray[np.float32], variance: float) -> NDArray[np.float32]:
    detail = float(np.mean(np.square(band, dtype=np.float32), dtype=np.float64)) - variance
    if detail <= 0:
        return np.zeros_like(band)
    threshold = np.float32(variance / detail**0.5)
    return np.asarray(np.sign(band) * np.maximum(np.abs(band) - threshold, 0), np.float32)


def noise_of(even: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Return the standard deviation of the noise of each channel, (3,), of (H, W, 3) uint16 whose noise is even over
    brightness; 0 where nothing can be told.

    By the second difference that a plane or a straight edge leaves at 0 (Immerkaer, CVIU 64, 1996), in the
    flattest tenth of the blocks that are not clipped. Of every second pixel, and of each such quarter of the
    picture by itself: demosaicing leaves some of them with more noise than others.
    """
    phases = [(y, x) for y in range(_STRIDE) for x in range(_STRIDE)]
    squares = [_flattest(_squares(even[y::_STRIDE, x::_STRIDE])) for y, x in phases]
    return np.asarray(np.sqrt(np.mean(squares, axis=0) / _LAPLACIAN_POWER))


def _flattest(square: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of (n, 3) over the flattest blocks that show anything, (3,)."""
    shows = square[(square > 0).all(axis=1)]
    if not len(shows):
        return np.zeros(3)
    roughness = (shows / np.median(shows, axis=0)).sum(axis=1)
    flattest = np.argsort(roughness, kind="stable")[: max(1, int(_FLATTEST * len(shows)))]
    return np.asarray(shows[flattest].mean(axis=0))


def _squares(even: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Return the mean square of the second difference in each unclipped block, (n, 3)."""
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
    """Return values over which noise is even, 16 bit."""
    if rgb.dtype == np.uint8:
        return np.asarray(rgb, np.uint16) * np.uint16(_OF_8_BIT)
    return np.asarray(_ROOT[rgb], np.uint16)


def _linear(noisy: NDArray[np.float32], smooth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the linear values of square roots: the mean of a square is the square of the mean, and the variance that
    was taken out."""
    removed = np.asarray(cv2.blur((noisy - smooth) ** 2, (_REMOVED, _REMOVED)))
    root = np.maximum(smooth, 0)
    return np.asarray((root * root + removed) * np.float32(1 / _DEPTH), np.float32)


_ROOT = np.rint(np.sqrt(np.arange(_DEPTH + 1) * float(_DEPTH))).astype(np.uint16)
