"""Draw façades, plan and sections of a model in metres."""

from __future__ import annotations

from pathlib import Path

from colmap_ihe.drawings.choose import chosen_views
from colmap_ihe.drawings.grid import BAND_PIXELS
from colmap_ihe.drawings.make import ABOUT
from colmap_ihe.drawings.overview import MOST_PIXELS
from colmap_ihe.errors import OptionError, ProjectError
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.machine.words import listed
from colmap_ihe.pipeline.drawings import (
    BY_RUN,
    draw_views,
    drawn_model,
    folders_made_by,
    missing_libraries,
    tiff_hint,
    warned,
)
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import NameBelow, Record, RunContext, Stage, StageRecord
from colmap_ihe.pipeline.stages.dense import pixels_seen
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_PIXEL, _OVERVIEW_PIXEL, _FACE = 40, 20, 1_500  # bytes of memory


class DrawingsRecord(StageRecord):
    """Name the files of the drawings below drawings/; none where none were to be made."""

    files: list[NameBelow]


def run(run: RunContext, progress: Progress) -> DrawingsRecord:
    """Draw the views of project.yaml, or those that are found. What cannot be drawn is a warning: the model is there
    all the same."""
    options = run.options.drawings
    if not run.records["mesh"]["files"] or (options.enabled == "auto" and not run.is_metric):
        return DrawingsRecord(files=[], warnings=[])
    if missing := missing_libraries():
        verb = "is" if len(missing) == 1 else "are"
        told = (
            f"no drawings are made, as {listed(missing)} {verb} not installed: pip install 'colmap-ihe[survey]', and"
            " run again with --from drawings"
        )
        return DrawingsRecord(files=[], warnings=[told])
    try:
        model = drawn_model(run)
        views = chosen_views(options, model)
        drawn = draw_views(run, model, views, BY_RUN, progress, strict=False)
    except (OptionError, ProjectError) as error:
        return DrawingsRecord(files=[], warnings=[warned(error)])
    files = [f"{name}/{file}" for name, about in drawn.drawings.items() for file in (*about["files"], ABOUT)]
    return DrawingsRecord(files=files, warnings=[*drawn.warnings, *tiff_hint()])


def _switched_off(options: Options) -> str:
    if options.drawings.enabled is False:
        return "drawings"
    return next((name for name in ("dense", "mesh") if not getattr(options, name).enabled), "")


def _files(project: Project, record: Record) -> list[Path]:
    return [project.drawings / name for name in record["files"]]


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    memory = BASE_BYTES + _PIXEL * BAND_PIXELS + _OVERVIEW_PIXEL * MOST_PIXELS + _FACE * options.mesh.faces
    return StageNeeds("drawings", memory, 0, round(pixels_seen(options, size)))


def _parts(options: Options, known: Known) -> list[Part]:
    if options.drawings.enabled == "auto" and not known.metric:
        return []
    images, megapixels = known.registered, known.registered_megapixels
    return [
        Part("drawings", "photographs looked through", 0.2 * megapixels + 0.06 * images),
        Part("drawings", "photographs compared at seams", 0.042 * megapixels + 0.028 * images),
        Part("drawings", "pictures and sheets", 15.0),
    ]


STAGE = Stage(
    "drawings",
    run,
    DrawingsRecord,
    sections=("drawings",),
    libraries=("opencv", "numpy"),
    switched_off=_switched_off,
    files=_files,
    made=lambda project: folders_made_by(project, BY_RUN),
    needs=_needs,
    parts=_parts,
)
