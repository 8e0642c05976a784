"""Draw a project that is reconstructed: its façades, or what the command line asks for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from colmap_ihe.drawings.choose import chosen_views, view_of
from colmap_ihe.errors import CapabilityError, OptionError, ProjectError
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.machine.words import listed
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.pipeline.drawings import BY_COMMAND, draw_views, drawn_model, missing_libraries
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stage import Record, RunContext
from colmap_ihe.project.folder import Project
from colmap_ihe.project.option_sections import DrawingView, require_drawing_name
from colmap_ihe.project.options_file import project_options

_NEEDED = ("captures", "convert", "sparse", "survey", "dense", "mesh")


def draw(
    project: Path,
    assignments: Sequence[str] = (),
    images: Path | None = None,
    *,
    only: str = "",
    asked: DrawingView | None = None,
    progress: RunProgress = SILENT,
) -> dict[str, dict[str, Any]]:
    """Draw the views of a project that is reconstructed, `only` the one of that name, or the one that is `asked` for
    under that name; and return what their drawing.json say, by name. Raises `KnownError`s, `Cancelled`."""
    if missing := missing_libraries():
        raise CapabilityError(
            f"drawings need {listed(missing)}, which {'is' if len(missing) == 1 else 'are'} not installed",
            hint="pip install 'colmap-ihe[survey]'",
        )
    options, folder = project_options(project, list(assignments)), Project.at(project, images)
    records: dict[str, Record] = {}
    for stage in _NEEDED:
        record = read_record(folder, stage)
        if record is not None:
            records[stage] = record
    if folder.mesh.name not in records.get("mesh", {}).get("files", ()) or not folder.mesh.is_file():
        raise ProjectError(
            f"{project}: there is no mesh to draw", hint="run `colmap-ihe reconstruct` first, with a mesh"
        )
    with folder.locked(), local_executor() as executor, progress.stage("drawings") as stage_progress:
        run = RunContext(folder, options, find_photographs(folder.images), executor, records=records)
        model = drawn_model(run)
        if asked is None:
            views = chosen_views(options.drawings, model, only)
        else:
            views = [view_of(_name(only), asked, options.drawings, model)]
        drawn = draw_views(run, model, views, BY_COMMAND, stage_progress, strict=True)
    for warning in drawn.warnings:
        progress.warn(warning)
    return drawn.drawings


def _name(name: str) -> str:
    try:
        return require_drawing_name(name)
    except ValueError as error:
        raise OptionError(str(error), hint="name the drawing with --view, as --view north") from error
