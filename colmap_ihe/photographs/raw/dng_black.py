"""The black level of a DNG that is no whole number for each colour: LibRaw takes the mean of what varies by row or
column, the least of a larger pattern than the colours', and cuts fractions off.

Digital Negative Specification 1.7: BlackLevelRepeatDim, BlackLevel, BlackLevelDeltaH, BlackLevelDeltaV.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from colmap_ihe.photographs.raw.mosaic import tiled

_CFA, _LINEAR_RAW = 32803, 34892
_MOST_PAGES = 32  # a directory may name itself as the next but one, again and again
_CELL = 2  # pixels a side of the cell of colours that LibRaw knows black levels of
_REPEAT, _LEVEL, _DELTA_H, _DELTA_V = 50713, 50714, 50715, 50716


def black_plane(path: Path, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    """Return the black level, (H, W) float32, in the sensor's units, of the visible picture; None where it is one whole
    number for each colour, where the file is no DNG, or where what it says does not fit `shape`."""
    if path.suffix.lower() != ".dng":
        return None
    try:
        with tifffile.TiffFile(path) as tiff:
            for page in _pages(tiff):
                if page.photometric in (_CFA, _LINEAR_RAW) and not _is_plain(page):
                    return _plane(page, shape)
    except Exception:  # noqa: BLE001  what is broken in the file is LibRaw's to say
        return None
    return None


def _pages(tiff: tifffile.TiffFile) -> Iterator[Any]:
    for page in islice(tiff.pages, _MOST_PAGES):
        yield page
        yield from getattr(page, "pages", None) or ()


def _is_plain(page: Any) -> bool:
    varies = _DELTA_H in page.tags or _DELTA_V in page.tags
    levels, repeat = _numbers(page, _LEVEL, [0]), _numbers(page, _REPEAT, [1, 1])
    return not varies and max(repeat) <= _CELL and bool((levels == np.rint(levels)).all())


def _plane(page: Any, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    height, width = shape
    rows, columns = _numbers(page, _REPEAT, [1, 1]).astype(int)
    levels = _numbers(page, _LEVEL, [0])
    if levels.size != rows * columns:
        return None
    horizontal = _numbers(page, _DELTA_H, np.zeros(width))
    vertical = _numbers(page, _DELTA_V, np.zeros(height))
    if horizontal.size != width or vertical.size != height:
        return None
    plane = tiled(levels.reshape(rows, columns), shape)
    return np.asarray(plane + horizontal[None, :] + vertical[:, None], np.float32)


def _numbers(page: Any, tag: int, default: Any) -> NDArray[np.float64]:
    """Return the values of a tag; tifffile gives rationals as numerator and denominator in turn."""
    if tag not in page.tags:
        return np.asarray(default, np.float64)
    entry = page.tags[tag]
    values = np.atleast_1d(np.asarray(entry.value, np.float64)).ravel()
    if entry.dtype.name in ("RATIONAL", "SRATIONAL"):
        return np.asarray(values[0::2] / values[1::2])
    return values
