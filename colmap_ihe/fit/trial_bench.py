"""Measure greys on windows of one pair of photographs, as COLMAP will see them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.two_views import Features, features_of, match, verified
from colmap_ihe.errors import PhotographError
from colmap_ihe.fit.overlaps import Box, Overlap
from colmap_ihe.fit.trial_result import Counts
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.convert import Tone, to_grey
from colmap_ihe.grey.weights import Formula, Grey
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture

_WINDOW = 600_000  # pixels at working resolution, where the first octave is 0
_FINER = 4  # so many times the pixels there are in the octave before
_KEPT = 10_000
"""Features a photograph. COLMAP takes whole levels of scale until there are more than 8,192 places: about a
tenth more, and some places have two orientations."""
_LEAST_KEPT = 100
_BLOB = 1.0  # pixels at half working resolution: about the smallest features that COLMAP keeps there
_LEAST_CONTRAST = 1.7  # grey levels, of COLMAP's SIFT
_LEAST_BLOBS = 300  # a photograph with fewer is taken for even
_CELLS = 4  # a side, of the grid over a window that the standard error comes from

_Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Trial:
    """Describe how COLMAP will see the photographs: the tone of linear ones, and the longer side in pixels."""

    tone: Tone = "sqrt"
    max_image_size: int = 3200


@dataclass(frozen=True, eq=False)
class _View:
    """Hold one photograph of a pair and the window in it. `scale`: working pixels per pixel; `kept`: how many
    features COLMAP would keep in the window."""

    rgb: _Pixels
    box: Box
    scale: float
    kept: int

    @property
    def size(self) -> tuple[int, int]:
        return self.rgb.shape[1], self.rgb.shape[0]


_Views = tuple[_View, _View]


@dataclass(frozen=True)
class Bench:
    """Hold what every measurement on a pair needs."""

    executor: Executor
    progress: Progress
    trial: Trial
    reference: Grey

    def load(self, overlap: Overlap) -> tuple[_Pixels, _Pixels] | None:
        """Return both photographs; None if one cannot be read after all."""

        def load(capture: Capture) -> _Pixels | None:
            try:
                return read_photograph(capture).rgb
            except PhotographError:
                return None

        both = (overlap.first, overlap.second)
        first, second = in_order(self.executor, load, both, progress=self.progress)
        return None if first is None or second is None else (first, second)

    def views(self, overlap: Overlap, both: tuple[_Pixels, _Pixels], pixels: float) -> _Views:
        """Return windows of so many pixels at working resolution."""
        sizes = [(rgb.shape[1], rgb.shape[0]) for rgb in both]
        scales = [min(1.0, self.trial.max_image_size / max(size)) for size in sizes]
        sides = [round(pixels**0.5 / scale) for scale in scales]
        boxes = overlap.boxes((sizes[0], sizes[1]), (sides[0], sides[1]))
        first, second = map(self.view, both, boxes, scales)
        return first, second

    def view(self, rgb: _Pixels, box: Box, scale: float) -> _View:
        return _View(rgb, box, scale, max(_LEAST_KEPT, round(_KEPT * self.share(rgb, box, scale))))

    def share(self, rgb: _Pixels, box: Box, scale: float) -> float:
        """Return how many of the photograph's features lie in the box, going by its blobs at half working
        resolution."""
        grey = to_grey(rgb, self.reference, self.trial.tone)
        height, width = (max(8, round(n * scale / 2)) for n in grey.shape)
        half = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.float32)
        band = cv2.GaussianBlur(half, (0, 0), _BLOB) - cv2.GaussianBlur(half, (0, 0), _BLOB * 2 ** (1 / 3))
        size = np.abs(band)
        blobs = (size >= _LEAST_CONTRAST) & (size >= cv2.dilate(size, np.ones((3, 3), np.uint8)))
        left, top, right, bottom = (round(n * scale / 2) for n in box)
        if blobs.sum() < _LEAST_BLOBS:
            return float((right - left) * (bottom - top) / blobs.size)
        return int(blobs[top:bottom, left:right].sum()) / int(blobs.sum())

    def features(self, views: _Views, greys: Sequence[Grey], first_octave: int) -> list[list[Features]]:
        """Return the features of both windows in each grey that COLMAP would keep, at places in whole photographs."""
        jobs = [(view, grey) for grey in greys for view in views]
        windows = list(in_order(self.executor, lambda job: _window(*job, self.trial.tone), jobs))
        found = features_of(windows, self.progress, first_octave=first_octave)
        whole = [
            _in_photograph(f.coarsest(view.kept), view) for f, (view, _) in zip(found, jobs, strict=True)
        ]
        return [whole[n : n + 2] for n in range(0, len(whole), 2)]

    def counts(self, views: _Views, greys: Sequence[Grey], first_octave: int) -> list[Counts]:
        """Return what each grey brings on a pair, equal greys measured once."""
        unlike = {_look(grey): grey for grey in greys}

        def count(found: list[Features]) -> Counts:
            first, second = found
            pairs = match(first, second)
            ones, others = first.places[pairs[:, 0]], second.places[pairs[:, 1]]
            kept = verified(ones, others, views[0].size, views[1].size)
            return Counts(len(first) + len(second), len(pairs), _by_cell(ones[kept], views[0].box))

        self.progress.start(len(unlike), "greys")
        counted: dict[object, Counts] = {}
        features = self.features(views, list(unlike.values()), first_octave)
        for look, counts in zip(unlike, in_order(self.executor, count, features), strict=True):
            counted[look] = counts
            self.progress.advance()
        return [counted[_look(grey)] for grey in greys]


@dataclass(frozen=True, eq=False)
class Pair:
    """Hold a pair that was read, and how its windows are measured: from which octave, at so many pixels."""

    bench: Bench
    overlap: Overlap
    both: tuple[_Pixels, _Pixels]
    first_octave: int

    @property
    def names(self) -> tuple[str, str]:
        return self.overlap.first.name, self.overlap.second.name

    def counts(self, greys: Mapping[str, Grey], smaller: int = 1) -> list[Counts]:
        """Return what each grey brings, in windows that are so many times smaller."""
        pixels = _WINDOW / (1 if self.first_octave == 0 else _FINER) / smaller
        views = self.bench.views(self.overlap, self.both, pixels)
        return self.bench.counts(views, list(greys.values()), self.first_octave)


def readable_pairs(bench: Bench, overlaps: Sequence[Overlap]) -> Iterator[Pair]:
    """Yield the pairs whose photographs can be read."""
    first_octave: int | None = None
    for overlap in overlaps:
        both = bench.load(overlap)
        if both is None:
            continue
        if first_octave is None:
            # Where COLMAP has its fill of features of two pixels and more, which takes a quarter of the time.
            views = bench.views(overlap, both, _WINDOW / _FINER)
            coarse = sum(map(len, bench.features(views, [bench.reference], 0)[0]))
            first_octave = 0 if coarse >= sum(view.kept for view in views) else -1
        yield Pair(bench, overlap, both, first_octave)


def _window(view: _View, grey: Grey, tone: Tone) -> NDArray[np.uint8]:
    """Return the window in this grey, at working resolution: (H, W) uint8."""
    left, top, right, bottom = view.box
    if isinstance(grey, Formula) and CONVERSIONS[grey.method].scope == "image":
        whole = to_grey(view.rgb, grey, tone)  # on all of which the window's grey depends
        window = whole[top:bottom, left:right]
    else:
        window = to_grey(view.rgb[top:bottom, left:right], grey, tone)
    if view.scale < 1:
        size = [max(1, round(n * view.scale)) for n in (right - left, bottom - top)]
        window = np.asarray(cv2.resize(window, size, interpolation=cv2.INTER_AREA), np.uint8)
    return np.ascontiguousarray(window)


def _in_photograph(found: Features, view: _View) -> Features:
    places = found.places / view.scale + np.array(view.box[:2])
    return Features(places, found.scales / view.scale, found.descriptors)


def _look(grey: Grey) -> object:
    """Return what two greys have in common that make the same picture."""
    if isinstance(grey, Formula):
        return grey.method, grey.parameters, grey.white
    return grey.triplet, grey.white


def _by_cell(places: NDArray[np.float64], box: Box) -> tuple[int, ...]:
    """Return how many of (N, 2) places lie in each cell of a grid over the box."""
    edges = [np.linspace(box[n], box[n + 2], _CELLS + 1) for n in (0, 1)]
    counted, _, _ = np.histogram2d(places[:, 0], places[:, 1], bins=edges)
    return tuple(int(n) for n in counted.ravel())
