"""Describe one stage of a project: all that the pipeline needs to know of it, as plain functions.

Each file in `pipeline/stages/` makes one `Stage`; nothing else in the package knows how a stage does its work.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from colmap_ihe.machine.files import is_name_below
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline.resource_needs import PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.run_context import Inputs, Record, RunContext
from colmap_ihe.pipeline.time_estimate import Known
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


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
    """Hold what a stage returns, which becomes its record on disk: what later stages, summary and page build on."""

    warnings: list[str] = []
    left_out: dict[str, str] = {}


@dataclass(frozen=True)
class Stage:
    """Hold all that the pipeline knows of one stage.

    `sections`, `libraries`: the option sections and the modules that affect its result; `result_options`: of the
    options what affects it, the sections as they are if None. `inputs`: the user's files that it reads. `files`: what
    it left that others need, from its record; `made`: all that it makes, which `remove` removes. `is_sound`: whether
    its files are whole, for a database, into which other programs may write too; files of other stages must be as they
    were written. `check`: refuses options before any work, for so many photographs. `needs`: memory and disk; `parts`:
    its parts with the time that each takes.
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
    needs: Callable[[Options, PhotoSetSize], StageNeeds | None] = lambda options, size: None
    parts: Callable[[Options, Known], list[Part]] = lambda options, known: []

    def options_of(self, options: Options) -> dict[str, Any]:
        """Return the options that affect the result, as plain values by section."""
        if self.result_options is not None:
            return self.result_options(options)
        return section_values(options, *self.sections)


def section_values(options: Options, *sections: str) -> dict[str, Any]:
    """Return option sections as plain values by name."""
    return {name: getattr(options, name).model_dump(mode="json") for name in sections}
