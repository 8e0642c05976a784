"""Make images in which COLMAP finds at their own resolution what it finds there by way of the doubled image.

COLMAP doubles an image by linear interpolation, which blurs it a little, and reckons without that blur. So features in
the image's own resolution are not the same without the doubled image: fewer, and less exactly placed. Here an image
gets that blur. It is rounded to grey levels so that the error of a pixel goes on to the next one of its row: such
errors are gone at the scales of features, where those of plain rounding are not (benchmarks/coarse_first.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

VARIANCE = 1 / 7
"""Of the blur, in square pixels: 1/8 of the interpolation, whose weights are a quarter, a half and a quarter, half a
pixel apart, and what keeps the number of features the same in spite of the rounding (benchmarks/coarse_first.md)."""
_ROWS = 32  # at a time, which stay in the cache of a core
_MOST = 1 / 2  # of three taps: those of one half and two quarters

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]


def write_as_doubled(grey: Path, names: Sequence[str], folder: Path, largest: int, threads: int) -> list[str]:
    """Write images below `grey` to the same names below `folder`, as if they had been doubled and made smaller again.
    `largest`: pixels of the longer side above which COLMAP looks at a smaller copy. Return the names of those that can
    be read."""

    def write(name: str) -> bool:
        bitmap = pycolmap.Bitmap.read(grey / name, as_rgb=False)
        if bitmap is None:
            return False
        image = np.asarray(bitmap.to_array(), np.uint8).reshape(bitmap.height, bitmap.width)
        pixels = as_doubled(image, max(1.0, max(image.shape) / largest))
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        header = f"P5\n{image.shape[1]} {image.shape[0]}\n255\n".encode()
        # COLMAP goes by what is in a file, not by its name
        (folder / name).write_bytes(header + pixels.tobytes())
        return True

    with ThreadPoolExecutor(threads) as pool:
        return [name for name, written in zip(names, pool.map(write, names), strict=True) if written]


def as_doubled(grey: U8, pixel: float = 1.0) -> U8:
    """Return (H, W) uint8, blurred as COLMAP's doubled image is; `pixel`: the size, in pixels of the image, of those of
    the copy at which COLMAP looks."""
    taps = taps_of(VARIANCE * pixel**2)
    blurred = cv2.sepFilter2D(grey, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_REPLICATE)
    return rounded(np.asarray(blurred, np.float32))


def taps_of(variance: float) -> F32:
    """Return the taps of a blur of this variance in square pixels: three, or as many as several such blurs have."""
    times = int(np.ceil(variance / _MOST))
    side = variance / (2 * times)
    taps = np.ones(1)
    for _ in range(times):
        taps = np.convolve(taps, (side, 1 - 2 * side, side))
    return np.asarray(taps, np.float32)


def rounded(levels: F32) -> U8:
    """Return (H, W) uint8 of grey levels (H, W), the error of each pixel added to the next of its row: rounded sums
    along a row differ from one to the next by these."""
    whole = np.empty(levels.shape, np.uint8)
    for start in range(0, len(levels), _ROWS):
        sums = np.rint(np.cumsum(levels[start : start + _ROWS], axis=1, dtype=np.float64))
        whole[start : start + _ROWS] = np.clip(np.diff(sums, axis=1, prepend=0), 0, 255)
    return whole
