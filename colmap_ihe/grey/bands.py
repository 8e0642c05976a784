"""Call the compiled loops (kernels.c) that measure bands of detail in pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.compiled import C, at, check, length

Band = NDArray[np.float32]
"""(10,): the taps of two Gaussians of 7, from the middle outwards, whose difference is a band of detail; then the
least and the greatest value, of a pixel's brightest channel, with which the pixel counts."""

BAND_REACH = 6
"""Pixels around one that its value in a band comes from."""
_SUMS = 8


def measure_detail(tile: NDArray[np.generic], band: Band) -> NDArray[np.float64]:
    """Return, of the band of a tile, (H, W, 3) uint8 or uint16, at half its size and of sums of 2x2 values, the sums
    of the products RR, GG, BB, RG, RB, GB, and how many pixels they are of: (7,). A pixel counts with all within 3 of
    it. `2 * BAND_REACH` pixels at each side of the tile are taken for their values alone."""
    out = np.zeros(_SUMS)
    _measure(C.measure_detail, tile, 2 * BAND_REACH, band, out)
    return out[:-1]


def measure_blocks(tile: NDArray[np.generic], band: Band) -> NDArray[np.float32]:
    """Return, of the band of a tile, (H, W, 3) uint8 or uint16, for each block of 8x8 pixels the sums of the products
    RR, GG, BB, RG, RB, GB, the sum of the values, and how many pixels count: (n, 8). `BAND_REACH` pixels at each side
    of the tile are taken for their values alone."""
    down, across = ((n - 2 * BAND_REACH) // 8 for n in tile.shape[:2])
    out = np.empty((down * across, _SUMS), np.float32)
    _measure(C.measure_blocks, tile, BAND_REACH, band, out)
    return out


def _measure(
    function: Callable[..., None], tile: NDArray[np.generic], reach: int, band: Band, out: NDArray[Any]
) -> None:
    height, width = tile.shape[:2]
    if (
        tile.dtype not in (np.uint8, np.uint16)
        or tile.shape[2:] != (3,)
        or min(height, width) < 2 * reach + 2
    ):
        raise ValueError(f"{tile.shape=} {tile.dtype=}, expected at least {2 * reach + 2} pixels each way")
    check(band, np.float32, (10,))
    size = tile.itemsize
    if tile.strides[1:] != (3 * size, size) or tile.strides[0] < 0 or not tile.flags.aligned:
        tile = np.array(tile, order="C")
    scratch = np.empty((8, height, width), np.float32)
    sizes = (length(n) for n in (tile.strides[0], size == 2, height, width))
    function(at(tile), *sizes, at(band), at(scratch), at(out))
