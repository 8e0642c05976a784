"""Describe one stage of a project, and the run over a project as its stages see it.

Each file in `pipeline/stages/` makes one `Stage`: all that the pipeline needs of it, as plain functions. Nothing
else in the package knows how a stage does its work.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from colmap_ihe.machine.files import is_name_below
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.photographs.discover import Capture, Discovery
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.resource_needs import Known, PhotoSetSize, StageNeeds
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.recipe import recipe_from_dict

Record = dict[str, Any]
"""The record of a finished stage, as on disk."""
Inputs = Mapping[str, Mapping[str, str]]
"""The user's files that a stage reads, by kind and name, with the digest of their content."""


def _require_below(name: str) -> str:
    if not is_name_below(name):
        raise ValueError("is no file of the folder")
    return name


def require_plain(name: str) -> str:
    """Return a file's name that holds no folder. Raises ValueError."""
    if len(PurePosixPath(_require_below(name)).parts) != 1:
        raise ValueError("is no name of a file")
    return name


Count = Annotated[int, Field(ge=0, lt=2**63)]
NameBelow = Annotated[str, AfterValidator(_require_below)]
"""A file within a folder, by its path from there."""
FileName = Annotated[str, AfterValidator(require_plain)]


class StrictModel(BaseModel):
    """Take plain values of the expected types only; further fields may stand beside them."""

    model_config = ConfigDict(extra="allow", strict=True)


class StageRecord(StrictModel):
    """Hold what a stage returns, which becomes its record on disk: what later stages, summary and page build on.
    `peak_memory_bytes`: the most that one process of the run held until the stage ended, 0 where nobody knows."""

    warnings: list[str] = []
    left_out: dict[str, str] = {}
    peak_memory_bytes: Count = 0


@dataclass(frozen=True)
class Shortfall:
    """Say why what a stage made is too poor for the stages after it, and what to do."""

    reason: str
    hint: str


@dataclass
class RunContext:
    """Hold what a run was given, and what its stages have found so far. It ends with the stage `until`, and runs those
    that are `forced` in any case, by name.

    `records` holds the records of the stages before this one; `resumed` is True if this stage was begun
    with the same fingerprint and not finished, so that its files may be kept. `developed`: where RAW photographs are
    kept developed for other runs on them, if anywhere. `digests` as `digests_of` found them when the run began, and
    `inputs` of them by stage, kind and name; `prints`: the fingerprint that the record of each stage is to have.
    `needs` of its stages, by name, once `captures` is done. `shortfall`: why it ended before its last stage, if it did.
    """

    project: Project
    options: Options
    discovery: Discovery
    executor: Executor
    until: str = ""
    forced: Sequence[str] = ()
    records: dict[str, Record] = field(default_factory=dict)
    resumed: bool = False
    surveyed: list[Surveyed] = field(default_factory=list)
    developed: Path | None = None
    digests: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    needs: Mapping[str, StageNeeds] = field(default_factory=dict)
    inputs: Mapping[str, Inputs] = field(default_factory=dict)
    prints: Mapping[str, str] = field(default_factory=dict)
    shortfall: Shortfall | None = None

    @property
    def strict(self) -> bool:
        return self.options.captures.strict

    @property
    def contents(self) -> Mapping[str, str]:
        """Return the digest of each photograph's content by name."""
        return self.inputs.get("captures", {}).get("photographs", {})

    def captures(self) -> list[Capture]:
        """Return the captures that every stage so far could use, with their recipes."""
        out: set[str] = set()
        for record in self.records.values():
            out |= set(record.get("left_out", {}))
        first = self.records["captures"]
        recipes = {
            name: recipe_from_dict(values, self.project.masters) for name, values in first["recipes"].items()
        }
        known = {s.capture.name: s.capture for s in self.surveyed}
        return [
            known.get(c.name)
            or self.kept(replace(c, recipe=recipes.get(c.name, c.recipe), pixels=first["largest"]))
            for c in self.discovery.captures
            if c.name not in out
        ]

    def kept(self, capture: Capture) -> Capture:
        """Return the capture, to be kept developed if those of this run are."""
        if self.developed is None or capture.kind != "raw":
            return capture
        return replace(capture, recipe=replace(capture.recipe, cache_folder=str(self.developed)))

    @property
    def is_metric(self) -> bool:
        return is_metric(self.records)

    @property
    def model_folder(self) -> Path:
        """Return the folder of the largest model: that in metres, if there is one."""
        return self.project.metric if self.is_metric else self.project.sparse / "0"

    def grey_names(self) -> list[str]:
        """Return the names of the grey images."""
        return sorted(self.records["convert"]["grey"].values())

    def photographs_by_grey(self) -> dict[str, str]:
        """Return the names of the photographs by those of their grey images."""
        return {grey: name for name, grey in self.records["convert"]["grey"].items()}


def is_metric(records: Mapping[str, Mapping[str, Any]]) -> bool:
    """Tell whether a survey brought the model into metres, by the records of the stages."""
    return bool(records.get("survey", {}).get("method"))


@dataclass(frozen=True)
class Stage:
    """Hold all that the pipeline knows of one stage.

    `sections`, `libraries`: the option sections and the modules that affect its result; `result_options`: of the
    options what affects it, the sections as they are if None. `inputs`: the user's files that it reads. `files`: what
    it left that others need, from its record; `made`: all that it makes, which `remove` removes. `is_sound`: whether
    its files are whole, for a database, into which other programs may write too; files of other stages must be as they
    were written. `check`: refuses options before any work, for so many photographs. `shortfall`: why its result is too
    poor for the stages after it, None if it is not. `needs`: memory and disk; `parts`: its parts with the time that
    each takes.
    """

    name: str
    run: Callable[[RunContext, Progress], StageRecord]
    record: type[StageRecord]
    sections: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    result_options: Callable[[Options], dict[str, Any]] | None = None
    switched_off: Callable[[Options], str] = lambda options: ""
    inputs: Callable[[Project, Options, Discovery, Mapping[str, Sequence[Any]]], Inputs] = lambda *_: {}
    files: Callable[[Project, Record], list[Path]] = lambda project, record: []
    made: Callable[[Project], list[Path]] = lambda project: []
    remove: Callable[[Project], None] | None = None
    is_sound: Callable[[Project], bool] | None = None
    check: Callable[[Options, int], None] = lambda options, images: None
    shortfall: Callable[[Options, Record], Shortfall | None] = lambda options, record: None
    needs: Callable[[Options, PhotoSetSize], StageNeeds | None] = lambda options, size: None
    parts: Callable[[Options, Known], list[Part]] = lambda options, known: []

    def options_of(self, options: Options) -> dict[str, Any]:
        """Return the options that affect the result, as plain values by section."""
        if self.result_options is not None:
            return self.result_options(options)
        return options.sections(*self.sections)
