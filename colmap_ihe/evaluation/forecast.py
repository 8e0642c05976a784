"""What remains of a comparison, while one of its methods is at work."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from colmap_ihe.machine.progress import Progress, RunProgress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.pipeline.estimates import stage_parts
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.pipeline.time_estimate import Known
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


@dataclass(frozen=True)
class Ahead:
    """An `RunProgress` of the run of the first of `methods`, that lets `progress` foresee the rest too."""

    progress: RunProgress
    project: Project
    options: Options
    methods: Sequence[str]
    seeds: int

    def expect(self, parts: Sequence[Part]) -> None:
        found = {name: read_record(self.project, name) for name in STAGE_NAMES}
        known = Known.from_records({name: record for name, record in found.items() if record})
        road = stage_parts(self.options, known, "dense" if self.options.dense.enabled else "sparse")
        coming: list[Part] = []
        for number, method in enumerate(self.methods):
            if number:
                coming += [part for part in road if part.stage in ("fit", "convert", "features", "matches")]
            for seed in range(self.seeds + 1):
                coming += [replace(p, stage=run_name(method, seed)) for p in road if p.stage == "sparse"]
            coming += [replace(p, stage=dense_name(method)) for p in road if p.stage == "dense"]
        self.progress.expect([*parts, *coming])

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        return self.progress.stage(name)

    def kept(self, name: str) -> None:
        self.progress.kept(name)

    def warn(self, text: str) -> None:
        self.progress.warn(text)


def run_name(method: str, seed: int) -> str:
    """What a run of the mapper is called to who watches."""
    return f"{method}, run {seed}"


def dense_name(method: str) -> str:
    return f"{method}, dense"
