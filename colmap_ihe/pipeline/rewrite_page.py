"""Write the page of a project again, from what its stages left."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.files import read_json
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.pipeline.page import write_page
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.run_context import Record, RunContext
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import project_options
from colmap_ihe.report.summary import summarise


def report(
    project: Path,
    assignments: Sequence[str] = (),
    images: Path | None = None,
    progress: RunProgress = SILENT,
) -> Path:
    """Write report/index.html of a project again, from what its stages left, and return it. Raises
    `KnownError`s; `ProjectError` where nothing is converted yet."""
    options, folder = project_options(project, list(assignments)), Project.at(project, images)
    records: dict[str, Record] = {}
    for stage in STAGES:
        record = None if stage.switched_off(options) else read_record(folder, stage.name)
        if record is None:
            break
        records[stage.name] = record
    if "convert" not in records:
        raise ProjectError(
            f"{project}: no photograph is converted yet, so there is nothing to show",
            hint="run `colmap-ihe reconstruct` first",
        )
    summary = summarise(records, options)
    truth = (read_json(folder.summary_file) or {}).get("truth")  # of this very model, else it were gone
    if isinstance(truth, dict) and all(type(value) in (int, float) for value in truth.values()):
        summary["truth"] = truth
    with folder.locked(), local_executor() as executor, progress.stage("page") as stage_progress:
        run = RunContext(folder, options, find_photographs(folder.images), executor, records)
        return write_page(run, summary, stage_progress)
