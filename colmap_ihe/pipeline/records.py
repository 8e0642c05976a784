"""Read the records of finished stages, and tell whether what a stage left still holds.

A record that somebody wrote, or that a disk spoilt, counts for none. A stage is up to date if its record carries the
fingerprint that it would have now: of the options that affect its result, of the versions of what computes it, of the
user's files that it reads, and of the stage before it. Nothing is ever skipped because a file is there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from colmap_ihe.machine.files import fingerprint_of, read_json
from colmap_ihe.machine.libraries import __version__, library_versions
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.stage import Inputs, Record, Stage, StageRecord
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

INPUT_CHANGED = "what it reads changed"


class _FinishedStage(StageRecord):
    """Check what the pipeline itself notes of a finished stage."""

    fingerprint: str
    seconds: Annotated[float, Field(ge=0, lt=1e12)]
    options: dict[str, Any]
    versions: dict[str, Any]
    warnings: list[str]


def read_record(project: Project, stage: str) -> Record | None:
    """Return the record of a finished stage, None where there is none, or none that the stage could have left."""
    record = read_json(project.record_file(stage))
    return record if record is not None and is_valid(stage, record) else None


def is_valid(stage: str, record: Record) -> bool:
    """Tell whether a record is one that the stage of this name could have left."""
    try:
        for model in (_FinishedStage, STAGES[STAGE_NAMES.index(stage)].record):
            model.model_validate(record)
    except (ValidationError, TypeError, RecursionError):
        return False
    return True


def inputs_of(
    project: Project, options: Options, discovery: Discovery, digests: Mapping[str, Sequence[Any]]
) -> dict[str, Inputs]:
    """Return the user's files that each stage reads, by stage."""
    return {stage.name: stage.inputs(project, options, discovery, digests) for stage in STAGES}


def fingerprints(options: Options, inputs: Mapping[str, Inputs]) -> dict[str, str]:
    """Return what the record of each stage would have to carry to be true now, by stage."""
    previous = ""
    prints: dict[str, str] = {}
    for stage in STAGES:
        previous = fingerprint_of(
            stage.name, stage.options_of(options), versions_of(stage), inputs.get(stage.name, {}), previous
        )
        prints[stage.name] = previous
    return prints


def versions_of(stage: Stage) -> dict[str, str]:
    """Return the versions of everything that computes the stage's result."""
    return {"colmap-ihe": __version__, **library_versions(*stage.libraries)}


def why_stale(project: Project, stage: Stage, record: Record, prints: Mapping[str, str]) -> str:
    """Say why a record does not hold, empty if it does."""
    if record.get("fingerprint") != prints[stage.name]:
        return INPUT_CHANGED
    if missing := outputs.missing(stage, project, record):
        return _files_are(missing, "gone")
    if altered := outputs.altered(stage, project, record):
        return _files_are(altered, "damaged" if stage.is_sound else "not as it was written")
    return ""


def _files_are(files: Sequence[Path], state: str) -> str:
    if len(files) == 1:
        return f"{files[0].name} is {state}"
    return f"{files[0].name} and {len(files) - 1} more files are {state.replace('it was', 'they were')}"
