"""Bring local mean and contrast of a grey image towards targets (Wallis filter).

After Wallis 1976 as photogrammetry uses it (Baltsavias 1991): with m and s the mean and standard deviation
around a pixel,

    out = (I - m) * c S / (c s + (1 - c) S) + b M + (1 - b) m

Statistics are those of blocks, interpolated bilinearly between their centres. What a pixel becomes depends on its
surroundings: the same colour is not the same grey any more, not even within one photograph.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

TARGET_MEAN = 127.0
TARGET_DEVIATION = 50.0
CONTRAST = 0.7
"""c: how far contrast goes to its target. It bounds the gain too: c / (1 - c) where nothing is to be seen."""
BRIGHTNESS = 0.6
"""b: how far the mean goes to its target."""
BLOCK = 64
"""Pixels a side, about."""

_STRIP = 512  # rows at once, which bounds the memory


def wallis(grey: NDArray[np.uint8], block: int = BLOCK) -> NDArray[np.uint8]:
    """Return the enhanced image, (H, W) uint8, of grey (H, W) uint8, to the nearest level.

    The image is cut into blocks as near to `block` pixels a side as goes evenly, one at least; beyond the outermost
    centres their statistics hold. An even block has no deviation to divide by: its noise grows by c / (1 - c) at
    most. Masks are not known here, and what they leave out counts like the rest. Raises ValueError for anything else.
    """
    if grey.ndim != 2 or grey.dtype != np.uint8 or not grey.size:
        raise ValueError(f"{grey.shape=} {grey.dtype=}, expected (H, W) uint8")
    if block < 1:
        raise ValueError(f"{block=}, expected at least 1")
    rows, columns = (_edges(n, block) for n in grey.shape)
    mean, deviation = _statistics(grey, rows, columns)
    across = _places(columns)
    mean, deviation = _between(mean.T, across).T, _between(deviation.T, across).T
    down = _places(rows)
    result = np.empty_like(grey)
    for top in range(0, len(grey), _STRIP):
        strip = slice(top, top + _STRIP)
        m, s = _between(mean, down[strip]), _between(deviation, down[strip])
        gain = CONTRAST * TARGET_DEVIATION / (CONTRAST * s + (1 - CONTRAST) * TARGET_DEVIATION)
        out = (grey[strip] - m) * gain + BRIGHTNESS * TARGET_MEAN + (1 - BRIGHTNESS) * m
        result[strip] = np.clip(out, 0, 255) + 0.5
    return result


def _edges(length: int, block: int) -> NDArray[np.int64]:
    """Return where blocks begin, and the end: (n + 1,)."""
    count = max(1, round(length / block))
    return np.asarray(np.rint(np.linspace(0, length, count + 1)), np.int64)


def _statistics(
    grey: NDArray[np.uint8], rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return mean and standard deviation of every block, summed as integers."""
    sums, squares = [], []
    for top, bottom in pairwise(rows.tolist()):
        some = grey[top:bottom].astype(np.uint32)
        sums.append(np.add.reduceat(some.sum(axis=0, dtype=np.int64), columns[:-1]))
        squares.append(np.add.reduceat((some * some).sum(axis=0, dtype=np.int64), columns[:-1]))
    count = np.outer(np.diff(rows), np.diff(columns))
    mean = np.stack(sums) / count
    variance = np.maximum(np.stack(squares) / count - mean**2, 0)
    return mean.astype(np.float32), np.sqrt(variance).astype(np.float32)


def _places(edges: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return where each pixel lies among the centres of the blocks, in blocks."""
    centres = (edges[:-1] + edges[1:]) / 2
    middles = np.arange(edges[-1]) + 0.5
    return np.interp(middles, centres, np.arange(len(centres))).astype(np.float32)


def _between(values: NDArray[np.float32], places: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return rows of `values` interpolated at `places`."""
    before = np.minimum(places.astype(np.int64), len(values) - 1)
    after = np.minimum(before + 1, len(values) - 1)
    share = (places - before)[:, None].astype(np.float32)
    return np.asarray(values[before] * (1 - share) + values[after] * share, np.float32)
