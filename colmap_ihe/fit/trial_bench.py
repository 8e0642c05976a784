"""Measure greys on whole photographs of a set: features as COLMAP will keep them, and verified matches of pairs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.two_views import Features, features_kept_of, match, verified
from colmap_ihe.errors import PhotographError
from colmap_ihe.fit.overlaps import Overlap
from colmap_ihe.fit.trial_result import Counts
from colmap_ihe.grey.convert import Tone, to_grey
from colmap_ihe.grey.weights import Formula, Grey
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.project.options import FeaturesOptions

_CELLS = 4  # a side, of the grid over a photograph that the standard error comes from
_AT_ONCE = 8  # grey images in memory, or as many as there are cores


@dataclass(frozen=True)
class Trial:
    """Describe how COLMAP will see the photographs: the tone of linear ones, and which features it will keep."""

    tone: Tone = "sqrt"
    features: FeaturesOptions = field(default_factory=FeaturesOptions)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"tone": self.tone, "features": self.features.model_dump(mode="json")}


@dataclass(frozen=True, eq=False)
class _View:
    """Hold the features of a photograph in one grey. `size`: width and height in pixels."""

    size: tuple[int, int]
    features: Features


@dataclass
class Bench:
    """Hold what every measurement needs, and the features that were found, by photograph and grey."""

    executor: Executor
    progress: Progress
    trial: Trial
    unreadable: set[str] = field(default_factory=set)
    _views: dict[tuple[str, object], _View] = field(default_factory=dict)

    def look_at(self, captures: Iterable[Capture], greys: Sequence[Grey]) -> None:
        """Find the features of photographs in each grey, once; names of those that cannot be read are in
        `unreadable` afterwards."""
        unlike = {_look(grey): grey for grey in greys}
        known = [c for c in captures if c.name not in self.unreadable]
        missing = {c.name: c for c in known if any((c.name, look) not in self._views for look in unlike)}

        def convert(capture: Capture) -> list[tuple[tuple[str, object], NDArray[np.uint8]]] | None:
            looks = [look for look in unlike if (capture.name, look) not in self._views]
            try:
                rgb = read_photograph(capture).rgb
            except PhotographError:
                return None
            return [((capture.name, look), to_grey(rgb, unlike[look], self.trial.tone)) for look in looks]

        self.progress.start(len(missing), "photographs tried")
        converted = in_order(self.executor, convert, list(missing.values()), progress=self.progress)
        pending: list[tuple[tuple[str, object], NDArray[np.uint8]]] = []
        for capture, images in zip(missing.values(), converted, strict=True):
            if images is None:
                self.unreadable.add(capture.name)
            pending += images or []
            if len(pending) >= max(_AT_ONCE, local_workers()):
                self._extract(pending)
                pending = []
            self.progress.advance()
        self._extract(pending)

    def _extract(self, images: Sequence[tuple[tuple[str, object], NDArray[np.uint8]]]) -> None:
        found = features_kept_of([grey for _, grey in images], self.trial.features, self.progress)
        for (key, grey), features in zip(images, found, strict=True):
            self._views[key] = _View((grey.shape[1], grey.shape[0]), features)

    def counts(self, pairs: Sequence[Overlap], greys: Mapping[str, Grey]) -> list[list[Counts]]:
        """Return what each grey brings, pair by pair, of photographs that were looked at."""
        jobs = {(pair.names, _look(grey)) for pair in pairs for grey in greys.values()}
        ordered = sorted(jobs, key=repr)

        def count(job: tuple[tuple[str, str], object]) -> Counts:
            (first, second), look = job
            return _counts(self._views[first, look], self._views[second, look])

        counted = dict(zip(ordered, in_order(self.executor, count, ordered), strict=True))
        return [[counted[pair.names, _look(grey)] for grey in greys.values()] for pair in pairs]


def _counts(first: _View, second: _View) -> Counts:
    pairs = match(first.features, second.features)
    ones, others = first.features.places[pairs[:, 0]], second.features.places[pairs[:, 1]]
    kept = verified(ones, others, first.size, second.size)
    return Counts(len(first.features) + len(second.features), len(pairs), _by_cell(ones[kept], first.size))


def _by_cell(places: NDArray[np.float64], size: tuple[int, int]) -> tuple[int, ...]:
    column, row = np.clip((places / size * _CELLS).astype(int), 0, _CELLS - 1).T
    return tuple(np.bincount(row * _CELLS + column, minlength=_CELLS * _CELLS).tolist())


def _look(grey: Grey) -> object:
    """Return what two greys have in common that make the same picture."""
    if isinstance(grey, Formula):
        return grey.method, grey.parameters, grey.white
    return grey.triplet, grey.white
