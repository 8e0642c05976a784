"""The fit: the one place where the whole set meets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from queue import SimpleQueue
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.captures.decode import encoding_of, read_photograph
from colmap_ihe.captures.discover import Capture
from colmap_ihe.executor import in_order, local_workers
from colmap_ihe.grey.boxes import Triplet
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.conversions import CONVERSIONS, SetFit
from colmap_ihe.grey.convert import coded_share
from colmap_ihe.grey.histogram import Histogram, mass_of
from colmap_ihe.grey.ihe import count_levels, fit_histogram, white_point
from colmap_ihe.grey.weights import FIXED, Encoding, Formula, Grey, Weights, triplets
from colmap_ihe.options import FitOptions
from colmap_ihe.per_image import LeftOut, each_usable
from colmap_ihe.progress import Watch

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Fit:
    """The grey of the set, one for each encoding in it; `colour_white` is the white point of a linear
    set's colour twins, as a share of saturation."""

    weights: Mapping[Encoding, Grey]
    colour_white: float = 1.0
    left_out: LeftOut = field(default_factory=dict)

    @property
    def main(self) -> Grey:
        """Of the encoding with most images."""
        return max(self.weights.values(), key=lambda w: w.images)


@dataclass
class _Gathered:
    """What the fit has to know of some photographs of one encoding; adds to that of others."""

    histogram: Histogram
    contrast: Contrast
    formula: SetFit | None

    def add(self, rgb: Pixels, contrast: Contrast, sample: float) -> None:
        some = _sampled(rgb, sample)
        self.histogram.add(some)
        self.contrast = self.contrast + contrast
        if self.formula is not None:
            self.formula.add(coded_share(some))

    def __add__(self, other: _Gathered) -> _Gathered:
        formula = None if self.formula is None else self.formula + other.formula
        return _Gathered(self.histogram + other.histogram, self.contrast + other.contrast, formula)


class _Partial:
    """Sums for one set, one for two workers: they are large, and adding to one is quick beside decoding."""

    def __init__(self, options: FitOptions, encoding: Encoding) -> None:
        self._options, self._encoding = options, encoding
        self._count = (local_workers() + 1) // 2
        self._idle: SimpleQueue[_Gathered | None] = SimpleQueue()
        for _ in range(self._count):
            self._idle.put(None)

    @contextmanager
    def borrowed(self) -> Iterator[_Gathered]:
        part = self._idle.get()
        try:
            if part is None:
                new = CONVERSIONS[self._options.method].new_fit
                histogram = Histogram(self._encoding, self._options.weighting)
                part = _Gathered(histogram, Contrast(self._encoding), new() if new else None)
            yield part
        finally:
            self._idle.put(part)

    def total(self) -> _Gathered:
        return reduce(add, (p for p in (self._idle.get() for _ in range(self._count)) if p is not None))


def fit_captures(
    captures: Sequence[Capture], options: FitOptions, executor: Executor, watch: Watch, *, strict: bool
) -> Fit:
    """One grey for the whole set, from every pixel of every capture, one image in memory a worker.

    A set that mixes gamma-coded and linear photographs gets one for each: a sensor's red is not
    sRGB's red, so one triplet for both would mean two different greys. Raises `PhotographError` if strict,
    `ProjectError` if no photograph can be used.
    """
    left_out: LeftOut = {}
    partial = {encoding: _Partial(options, encoding) for encoding in {encoding_of(c) for c in captures}}

    def gather(capture: Capture) -> Capture:
        photograph = read_photograph(capture)
        contrast = Contrast(photograph.encoding)
        if options.method in ("ihe", "snr"):
            contrast.add(photograph.rgb, weighting=options.weighting)
        with partial[photograph.encoding].borrowed() as part:
            part.add(photograph.rgb, contrast, options.sample)
        return capture

    usable = list(each_usable(gather, captures, executor, watch, strict, left_out))
    weights: dict[Encoding, Grey] = {}
    colour_white = 1.0
    for encoding in sorted({encoding_of(c) for c in usable}):
        gathered = partial[encoding].total()
        members = [c for c in usable if encoding_of(c) == encoding]
        weights[encoding] = _grey_of(gathered, members, options, executor, watch)
        if encoding == "linear":
            colour_white = white_point(gathered.histogram, FIXED["green"])
    return Fit(weights, colour_white, left_out)


def _grey_of(
    gathered: _Gathered, members: Sequence[Capture], options: FitOptions, executor: Executor, watch: Watch
) -> Grey:
    histogram = gathered.histogram
    grid = triplets(options.step)
    linear = histogram.encoding == "linear"
    if options.method == "ihe":
        admitted = gathered.contrast.admitted(grid) if options.guard == "noise" else grid
        found = _fit_ihe(histogram, admitted, members, options, executor, watch)
        return replace(found, contrast=_contrast_of(gathered, found.triplet, grid))
    common: dict[str, Any] = {
        "method": options.method,
        "encoding": histogram.encoding,
        "images": histogram.images,
        "pixels": histogram.pixels,
    }
    if options.method in FIXED or options.method == "snr":
        triplet = FIXED.get(options.method) or _shares(gathered.contrast.best(grid))
        white = white_point(histogram, triplet) if linear else 1.0
        return Weights(*triplet, **common, white=white, contrast=_contrast_of(gathered, triplet, grid))
    parameters = () if gathered.formula is None else gathered.formula.finish()
    return Formula(
        **common, parameters=parameters, white=white_point(histogram, FIXED["green"]) if linear else 1.0
    )


def _contrast_of(
    gathered: _Gathered, triplet: tuple[float, float, float], grid: Sequence[Triplet]
) -> float | None:
    """As a share of the best of the grid; None where the set shows no detail."""
    red, green, blue = (round(100 * w) for w in triplet)
    best = float(gathered.contrast.snr_of(grid).max())
    return float(gathered.contrast.snr_of([(red, green, blue)])[0]) / best if best > 0 else None


def _shares(triplet: Triplet) -> tuple[float, float, float]:
    red, green, blue = triplet
    return red / 100, green / 100, blue / 100


def _fit_ihe(
    histogram: Histogram,
    grid: Sequence[Triplet],
    members: Sequence[Capture],
    options: FitOptions,
    executor: Executor,
    watch: Watch,
) -> Weights:
    def recount(chosen: Sequence[Triplet], whites: Sequence[int]) -> NDArray[np.int64]:
        def count(capture: Capture) -> NDArray[np.int64]:
            rgb = np.asarray(_sampled(read_photograph(capture).rgb, options.sample), np.uint16)
            return count_levels(rgb, chosen, whites) * mass_of(rgb, options.weighting)

        watch.start(len(members), f"images, for {len(chosen)} triplets")
        total: NDArray[np.int64] = np.zeros((len(chosen), 256), np.int64)
        for counts in in_order(executor, count, members):
            total += counts
            watch.advance()
        return total

    watch.start(len(grid), "triplets")
    return fit_histogram(histogram, grid, recount if histogram.encoding == "linear" else None, watch.advance)


def _sampled(rgb: Pixels, sample: float) -> Pixels:
    """rgb at `sample` of each side, nearest neighbour, at least one pixel."""
    if sample == 1:
        return rgb
    height, width = rgb.shape[:2]
    size = (max(1, round(width * sample)), max(1, round(height * sample)))
    resized: Any = cv2.resize(rgb, size, interpolation=cv2.INTER_NEAREST)
    return resized  # type: ignore[no-any-return]
