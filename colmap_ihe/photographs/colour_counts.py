"""What a decoder counts of the photographs that it decodes, so that their pixels need not leave it."""

from __future__ import annotations

import os
import sys
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.sums import Sums, Weighting
from colmap_ihe.grey.weights import Encoding

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


class ColourCounter:
    """The colours of some photographs of one encoding, `sample` of each side of them."""

    def __init__(self, encoding: Encoding, weighting: Weighting, sample: float) -> None:
        self._histogram = Histogram(encoding, weighting)
        self._sample = sample

    def may_begin(self, encoding: Encoding, weighting: Weighting, sample: float) -> bool:
        """Whether it holds nothing, and counts like this."""
        own = (self._histogram.encoding, self._histogram.weighting, self._sample)
        return not self._histogram.images and own == (encoding, weighting, sample)

    def add(self, rgb: Pixels, contrast: bool) -> Contrast | None:
        """Counts one photograph, (H, W, 3) as `Histogram.add` takes it, and with `contrast` measures it, in all of
        its pixels. Raises before anything of it is counted; ends the process rather than keep a part."""
        measured = Contrast(self._histogram.encoding) if contrast else None
        if measured is not None:
            measured.add(rgb, weighting=self._histogram.weighting)
        some = sampled(rgb, self._sample)
        try:
            self._histogram.add(some)
        except BaseException as error:  # noqa: BLE001  nobody could tell which of its pixels were counted
            print(f"{type(error).__name__} while it counted: {error}", file=sys.stderr, flush=True)
            os._exit(1)
        return measured

    def handed_over(self) -> Sums:
        """What was counted; nothing is left."""
        return self._histogram.taken()


def sampled(rgb: Pixels, sample: float) -> Pixels:
    """rgb at `sample` of each side, nearest neighbour, at least one pixel."""
    if sample == 1:
        return rgb
    height, width = rgb.shape[:2]
    size = (max(1, round(width * sample)), max(1, round(height * sample)))
    resized: Any = cv2.resize(rgb, size, interpolation=cv2.INTER_NEAREST)
    return resized  # type: ignore[no-any-return]
