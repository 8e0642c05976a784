"""Tell whether what a stage left still holds.

A stage is up to date if its record carries the fingerprint that it would have now: of the options that affect its
result, of the versions of what computes it, of the user's files that it reads, and of the stage before it. Nothing is
ever skipped because a file is there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from colmap_ihe.machine.files import fingerprint_of
from colmap_ihe.machine.libraries import __version__, library_versions
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.run_context import Inputs, Record
from colmap_ihe.pipeline.stage import Stage
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

INPUT_CHANGED = "what it reads changed"


def inputs_of(
    project: Project,
    options: Options,
    discovery: Discovery,
    digests: Mapping[str, Sequence[Any]],
    stages: Sequence[Stage] = STAGES,
) -> dict[str, Inputs]:
    """Return the user's files that each stage reads, by stage."""
    return {stage.name: stage.inputs(project, options, discovery, digests) for stage in stages}


def fingerprints(
    options: Options, inputs: Mapping[str, Inputs], stages: Sequence[Stage] = STAGES
) -> dict[str, str]:
    """Return what the record of each stage would have to carry to be true now, by stage."""
    previous = ""
    prints: dict[str, str] = {}
    for stage in stages:
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
