"""Measure greys on whole photographs of a set: features as COLMAP will keep them, and verified matches of pairs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.part_databases import Pair, ordered
from colmap_ihe.colmap.tried_features import PairMatches, add_pictures, match_pictures
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

_Picture = tuple[tuple[str, object], NDArray[np.uint8]]
"""The name of a photograph and its look in a grey, and that grey image."""


@dataclass(frozen=True)
class Trial:
    """Describe how COLMAP will see the photographs: the tone of linear ones, and which features it will keep. `keep`: a
    database for the features that are found, which else are forgotten."""

    tone: Tone = "sqrt"
    features: FeaturesOptions = field(default_factory=FeaturesOptions)
    keep: Path | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"tone": self.tone, "features": self.features.model_dump(mode="json")}


@dataclass
class Bench:
    """Hold what every measurement needs, and which features were found: `folder` for unfinished work, and by photograph
    and grey the id of each picture in `database` with its width and height in pixels."""

    executor: Executor
    progress: Progress
    trial: Trial
    folder: Path
    unreadable: set[str] = field(default_factory=set)
    _views: dict[tuple[str, object], tuple[int, tuple[int, int]]] = field(default_factory=dict)

    @property
    def database(self) -> Path:
        return self.trial.keep or self.folder / "tried.db"

    def look_at(self, captures: Iterable[Capture], greys: Sequence[Grey]) -> None:
        """Find the features of photographs in each grey, once; names of those that cannot be read are in
        `unreadable` afterwards."""
        unlike = {_look(grey): grey for grey in greys}
        known = [c for c in captures if c.name not in self.unreadable]
        missing = {c.name: c for c in known if any((c.name, look) not in self._views for look in unlike)}

        def convert(capture: Capture) -> list[_Picture] | None:
            looks = [look for look in unlike if (capture.name, look) not in self._views]
            try:
                rgb = read_photograph(capture).rgb
            except PhotographError:
                return None
            return [((capture.name, look), to_grey(rgb, unlike[look], self.trial.tone)) for look in looks]

        self.progress.start(len(missing), "photographs tried")
        converted = in_order(self.executor, convert, list(missing.values()), progress=self.progress)
        pending: list[_Picture] = []
        for capture, images in zip(missing.values(), converted, strict=True):
            if images is None:
                self.unreadable.add(capture.name)
            pending += images or []
            if len(pending) >= max(_AT_ONCE, local_workers()):
                self._extract(pending)
                pending = []
            self.progress.advance()
        self._extract(pending)

    def _extract(self, images: Sequence[_Picture]) -> None:
        pictures = [(name, grey) for (name, _), grey in images]
        ids = add_pictures(self.database, pictures, self.trial.features, self.progress)
        for (key, grey), image_id in zip(images, ids, strict=True):
            self._views[key] = image_id, (grey.shape[1], grey.shape[0])

    def counts(self, pairs: Sequence[Overlap], greys: Mapping[str, Grey]) -> list[list[Counts]]:
        """Return what each grey brings, pair by pair, of photographs that were looked at."""
        jobs: dict[tuple[tuple[str, str], object], Pair] = {}
        for pair in pairs:
            for look in map(_look, greys.values()):
                first, second = (self._views[name, look][0] for name in pair.names)
                jobs[pair.names, look] = ordered((first, second))
        found = match_pictures(self.database, set(jobs.values()), self.folder / "parts", self.progress)
        sizes = dict(self._views.values())
        counted = {job: _counts(found[ids], sizes[ids[0]]) for job, ids in jobs.items()}
        return [[counted[pair.names, _look(grey)] for grey in greys.values()] for pair in pairs]


def _counts(found: PairMatches, size: tuple[int, int]) -> Counts:
    return Counts(found.features, found.putative, _by_cell(found.places, size))


def _by_cell(places: NDArray[np.float64], size: tuple[int, int]) -> tuple[int, ...]:
    column, row = np.clip((places / size * _CELLS).astype(int), 0, _CELLS - 1).T
    return tuple(np.bincount(row * _CELLS + column, minlength=_CELLS * _CELLS).tolist())


def _look(grey: Grey) -> object:
    """Return what two greys have in common that make the same picture."""
    if isinstance(grey, Formula):
        return grey.method, grey.parameters, grey.white
    return grey.triplet, grey.white
