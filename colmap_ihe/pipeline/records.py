"""Read the records of finished stages: one that somebody wrote, or that a disk spoilt, counts for none."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationError

from colmap_ihe.machine.files import read_json
from colmap_ihe.pipeline.run_context import Record
from colmap_ihe.pipeline.stage import StageRecord
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES
from colmap_ihe.project.folder import Project


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
