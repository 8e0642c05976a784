"""Work through images as fast as a core can: in strips of rows, which stay in its cache, and without branches.

NumPy goes through all of its arrays at each step. On a whole photograph each step then waits for the memory, on a strip
it does not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.dense.camera import Bool

_PIXELS = 131_072  # of a strip: half a megabyte for each of its values


@dataclass(frozen=True)
class Strip:
    """Describe some rows of an image: `own`; `seen`, which are those and the ones beside that windows reach; and
    `inner`, where `own` lie among the latter."""

    own: slice
    seen: slice
    inner: slice


def strips(shape: tuple[int, ...], beside: int = 0) -> Iterator[Strip]:
    """Yield the rows of an image of `shape` (H, W) strip by strip; windows reach `beside` rows beyond their own."""
    height, width = shape
    step = max(8 * beside, _PIXELS // max(1, width), 1)
    for first in range(0, height, step):
        last = min(first + step, height)
        start = max(0, first - beside)
        seen = slice(start, min(height, last + beside))
        yield Strip(slice(first, last), seen, slice(first - start, last - start))


def overwrite(target: NDArray[Any], values: NDArray[Any], where: Bool) -> None:
    """Put `values` (H, W) into `target` (H, W) of the same dtype, `where` (H, W) is true. By OpenCV, which does not
    branch at each pixel: np.where and np.copyto take ten times as long if neighbours differ."""
    cv2.copyTo(values, where.view(np.uint8), target)
