"""Read records: one that somebody wrote, or that a disk spoilt, counts for none."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationError

from colmap_ihe.machine.files import read_json
from colmap_ihe.pipeline.run_context import Record
from colmap_ihe.pipeline.stage import StageRecord, StrictModel
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project


class _AnyRecord(StrictModel):
    """Check what every record has, also that of a run of `compare`."""

    fingerprint: str
    seconds: Annotated[float, Field(ge=0, lt=1e12)]


class _FinishedStage(_AnyRecord, StageRecord):
    """Check what the pipeline itself notes of a finished stage."""

    options: dict[str, Any]
    versions: dict[str, Any]
    warnings: list[str]


def read_record(project: Project, name: str) -> Record | None:
    """Return the record of this name, None where there is none, or none that its stage could have left."""
    record = read_json(project.record_file(name))
    return record if record is not None and is_valid(name, record) else None


def is_valid(name: str, record: Record) -> bool:
    """Tell whether a record is one that the stage of this name could have left, if it is that of a stage."""
    models: list[type[StrictModel]] = [_AnyRecord]
    for stage in STAGES:
        if stage.name == name:
            models = [_FinishedStage, stage.record]
    try:
        for model in models:
            model.model_validate(record)
    except (ValidationError, TypeError, RecursionError):
        return False
    return True
