"""What the fit has to know of a set, gathered by several workers at once, one photograph at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from operator import add
from queue import SimpleQueue
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.executor import local_workers
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.conversions import CONVERSIONS, SetFit
from colmap_ihe.grey.convert import coded_share
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.options import FitOptions

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass
class Gathered:
    """What the fit has to know of some photographs of one encoding; adds to that of others."""

    histogram: Histogram
    contrast: Contrast
    formula: SetFit | None

    def add(self, rgb: Pixels, contrast: Contrast, sample: float) -> None:
        some = sampled(rgb, sample)
        self.histogram.add(some)
        self.contrast = self.contrast + contrast
        if self.formula is not None:
            self.formula.add(coded_share(some))

    def __add__(self, other: Gathered) -> Gathered:
        formula = None if self.formula is None else self.formula + other.formula
        return Gathered(self.histogram + other.histogram, self.contrast + other.contrast, formula)


class Partial:
    """Sums for one set, one for two workers: they are large, and adding to one is quick beside decoding."""

    def __init__(self, options: FitOptions, encoding: Encoding) -> None:
        self._options, self._encoding = options, encoding
        self._count = (local_workers() + 1) // 2
        self._idle: SimpleQueue[Gathered | None] = SimpleQueue()
        for _ in range(self._count):
            self._idle.put(None)

    @contextmanager
    def borrowed(self) -> Iterator[Gathered]:
        part = self._idle.get()
        try:
            if part is None:
                new = CONVERSIONS[self._options.method].new_fit
                histogram = Histogram(self._encoding, self._options.weighting)
                part = Gathered(histogram, Contrast(self._encoding), new() if new else None)
            yield part
        finally:
            self._idle.put(part)

    def total(self) -> Gathered:
        return reduce(add, (p for p in (self._idle.get() for _ in range(self._count)) if p is not None))


def sampled(rgb: Pixels, sample: float) -> Pixels:
    """rgb at `sample` of each side, nearest neighbour, at least one pixel."""
    if sample == 1:
        return rgb
    height, width = rgb.shape[:2]
    size = (max(1, round(width * sample)), max(1, round(height * sample)))
    resized: Any = cv2.resize(rgb, size, interpolation=cv2.INTER_NEAREST)
    return resized  # type: ignore[no-any-return]
