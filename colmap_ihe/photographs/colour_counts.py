"""Colours that a decoder counts where it decodes, so that the pixels need not leave it."""

from __future__ import annotations

import os
import sys
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.histogram import Histogram, Sums, Weighting
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.photographs.decode import decode_photograph
from colmap_ihe.photographs.discover import Capture

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


class ColourCounter:
    """Count the colours of some photographs of one encoding, `sample` of each side of them."""

    def __init__(self, encoding: Encoding, weighting: Weighting, sample: float) -> None:
        self._histogram = Histogram(encoding, weighting)
        self._sample = sample

    def may_begin(self, encoding: Encoding, weighting: Weighting, sample: float) -> bool:
        """Tell whether it holds nothing, and counts like this."""
        own = (self._histogram.encoding, self._histogram.weighting, self._sample)
        return not self._histogram.images and own == (encoding, weighting, sample)

    def add(self, rgb: Pixels, contrast: bool) -> Contrast | None:
        """Count one photograph, (H, W, 3) as `Histogram.add` takes it, and with `contrast` measure it, in all of
        its pixels. Raises before anything of it is counted; ends the process rather than keep a part."""
        measured = Contrast(self._histogram.encoding) if contrast else None
        if measured is not None:
            measured.add(rgb, weighting=self._histogram.weighting)
        sample = sampled(rgb, self._sample)
        try:
            self._histogram.add(sample)
        except BaseException as error:  # noqa: BLE001  nobody could tell which of its pixels were counted
            print(f"{type(error).__name__} while it counted: {error}", file=sys.stderr, flush=True)
            os._exit(1)
        return measured

    def handed_over(self) -> Sums:
        """Return the sums of what was counted; nothing is left."""
        return self._histogram.taken()


_counter: ColourCounter | None = None
"""Of this decoder; used again once it was handed over, for making its pages takes long."""


def count_photograph(
    capture: Capture, first: bool, contrast: bool, returned: bool, counting: tuple[Encoding, Weighting, float]
) -> tuple[dict[str, Any] | None, NDArray[np.uint8] | NDArray[np.uint16] | None]:
    """Count the colours of a capture in this decoder, after those before unless it is the `first`, as the arguments of
    `ColourCounter` say. Return its contrast if asked for, as plain values, and its pixels if they are to be
    `returned`."""
    global _counter  # noqa: PLW0603  of the process, as a decoder answers one question at a time
    if _counter is None or (first and not _counter.may_begin(*counting)):
        _counter = ColourCounter(*counting)
    rgb = decode_photograph(capture).rgb
    measured = _counter.add(rgb, contrast)
    return None if measured is None else measured.as_dict(), rgb if returned else None


def hand_over_counts(_last: Capture) -> tuple[dict[str, Any], NDArray[np.uint8]]:
    """Return the sums that this decoder counted: `Sums.head`, and its cells as bytes (N,) uint8; nothing is left."""
    if _counter is None:
        raise ValueError("nothing was counted")
    sums = _counter.handed_over()
    return sums.head(), np.frombuffer(sums.cells, np.uint8)


def free_counter() -> None:
    """Give back the memory in which this decoder counts."""
    global _counter  # noqa: PLW0603
    _counter = None


def sampled(rgb: Pixels, sample: float) -> Pixels:
    """Return rgb at `sample` of each side, nearest neighbour, at least one pixel."""
    if sample == 1:
        return rgb
    height, width = rgb.shape[:2]
    size = (max(1, round(width * sample)), max(1, round(height * sample)))
    resized: Any = cv2.resize(rgb, size, interpolation=cv2.INTER_NEAREST)
    return resized  # type: ignore[no-any-return]
