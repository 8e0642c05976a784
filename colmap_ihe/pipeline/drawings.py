"""Draw the views of a project into its folder drawings/."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.colmap.measures import poses_of, upright
from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.drawings.choose import DrawnModel
from colmap_ihe.drawings.colours import PaintedSurface
from colmap_ihe.drawings.make import ABOUT, draw_section, draw_surface
from colmap_ihe.drawings.painted import painted_surface
from colmap_ihe.drawings.raster_files import has_rasterio
from colmap_ihe.drawings.sheet import letters_without_font
from colmap_ihe.drawings.view import Setting, View, layout_of
from colmap_ihe.errors import KnownError, OptionError, ProjectError
from colmap_ihe.machine import locks
from colmap_ihe.machine.executor import threads_of
from colmap_ihe.machine.files import read_json, replace_folder
from colmap_ihe.machine.progress import Progress
from colmap_ihe.pipeline.stage import RunContext
from colmap_ihe.pipeline.survey_records import survey_summary
from colmap_ihe.project.folder import Project
from colmap_ihe.report.survey_words import survey_in_words
from colmap_ihe.survey.frames import Frame

BY_RUN, BY_COMMAND = "reconstruct", "draw"
"""What a drawing is made by, as drawing.json says."""

_EARTH = 6_371_000.0  # metres: its radius; a metre high up is less of it on a map
_LIBRARIES = ("contourpy", "ezdxf", "reportlab")


@dataclass
class Drawn:
    """Hold what was drawn: what drawing.json says, by name; and why other drawings were not made, in words."""

    drawings: dict[str, dict[str, Any]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def missing_libraries() -> list[str]:
    """Return the names of packages that drawings need and that are not installed."""
    missing = []
    for name in _LIBRARIES:
        try:
            import_module(name)
        except ImportError:
            missing.append(name)
    return missing


def folders_made_by(project: Project, maker: str) -> list[Path]:
    """Return the folders of drawings that were made by a run, or by the command; and what unfinished ones left."""
    if not locks.is_marked(project.drawings):
        return []
    folders = []
    for folder in sorted(path for path in project.drawings.iterdir() if path.is_dir()):
        about = read_json(folder / ABOUT) or {}
        if folder.name.startswith(".") or about.get("made_by") == maker:
            folders.append(folder)
    return folders


def finished(project: Project) -> list[tuple[Path, dict[str, Any]]]:
    """Return the folder of each drawing, with what its drawing.json says, by name."""
    if not locks.is_marked(project.drawings):
        return []
    folders = sorted(path for path in project.drawings.iterdir() if not path.name.startswith("."))
    read = [(folder, read_json(folder / ABOUT)) for folder in folders if folder.is_dir()]
    return [(folder, about) for folder, about in read if isinstance(about, dict)]


def drawn_model(run: RunContext) -> DrawnModel:
    """Return the mesh of a run with its frame. Raises `ProjectError` where it cannot be read."""
    poses = list(poses_of(run.model_folder).values())
    cameras = np.mean([-pose[:, :3].T @ pose[:, 3] for pose in poses], axis=0)
    frame = Frame(**run.records["survey"]["frame"]) if run.is_metric else None
    up = np.array((0.0, 0.0, 1.0)) if run.is_metric else upright(poses, None)[1]
    return DrawnModel(read_mesh(run.project.mesh), np.asarray(up, np.float64), cameras, frame)


def setting_of(model: DrawnModel, title: dict[str, str], maker: str, accuracy: str = "") -> Setting:
    """Return what the drawings of a model have in common; `accuracy` of the survey in words."""
    frame = model.frame
    if frame is None:
        return Setting(False, model.up, title=title, made_by=maker)
    if frame.origin is None:
        return Setting(True, model.up, frame.offset, frame.crs, title, maker, accuracy)
    latitude, longitude, height = frame.origin
    place = f"+lat_0={latitude:.10f} +lon_0={longitude:.10f} +k={1 + height / _EARTH:.10f}"
    crs = f"+proj=tmerc {place} +datum=WGS84 +units=m"
    return Setting(True, model.up, (0.0, 0.0, height), crs, title, maker, accuracy)


def draw_views(
    run: RunContext, model: DrawnModel, views: Sequence[View], maker: str, progress: Progress, *, strict: bool
) -> Drawn:
    """Draw each view into a folder of its name, which is replaced as a whole. What cannot be drawn is a warning, or
    raised where `strict`. Raises `ProjectError` where drawings/ or a folder in it is the user's, `Cancelled`."""
    project = run.project
    if not locks.is_marked(project.drawings):
        locks.refuse_unmarked(project.drawings, "move it away: drawings are written there")
    title = run.options.drawings.title
    setting = setting_of(model, title, maker, survey_in_words(survey_summary(run.records.get("survey", {}))))
    drawn, surface = Drawn(warnings=_unprintable(title)), None
    views = _possible(views, model, setting, drawn, strict=strict)
    if any(view.kind != "section" for view in views):
        surface = _painted(run, model, progress)
    locks.make(project.drawings)
    for view in views:
        final = project.drawings / view.name
        temporary = final.with_name(f".{view.name}.new")
        shutil.rmtree(temporary, ignore_errors=True)
        try:
            _refuse_others(final)
            temporary.mkdir()
            drawn.drawings[view.name] = _draw(temporary, view, model, surface, setting, progress)
            replace_folder(temporary, final)
        except (OptionError, ProjectError) as error:
            if strict:
                raise
            drawn.warnings.append(f"not drawn: {error} ({error.hint})")
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return drawn


def _unprintable(title: Mapping[str, str]) -> list[str]:
    text = "".join(f"{name}{value}" for name, value in title.items())
    if not (odd := letters_without_font(text)):
        return []
    return [f"drawings.title: the fonts of the sheets have no {odd!r:.60}, which become question marks"]


def _possible(
    views: Sequence[View], model: DrawnModel, setting: Setting, drawn: Drawn, *, strict: bool
) -> list[View]:
    """Return the views that can be drawn, before any long work."""
    possible = []
    for view in views:
        try:
            if view.kind != "section":
                layout_of(view, model.mesh, setting)
        except OptionError as error:
            if strict:
                raise
            drawn.warnings.append(f"not drawn: {error} ({error.hint})")
        else:
            possible.append(view)
    return possible


def _refuse_others(folder: Path) -> None:
    if folder.exists() and not (folder / ABOUT).is_file():
        raise ProjectError(
            f"{folder}: is there already and is no drawing of colmap-ihe",
            hint="move it away, or name another",
        )


def _painted(run: RunContext, model: DrawnModel, progress: Progress) -> PaintedSurface:
    project = run.project
    with threads_of(run.executor) as threads:
        return painted_surface(model.mesh, project.dense, run.model_folder, project.colour, threads, progress)


def _draw(
    folder: Path,
    view: View,
    model: DrawnModel,
    surface: PaintedSurface | None,
    setting: Setting,
    progress: Progress,
) -> dict[str, Any]:
    if view.kind == "section" or surface is None:
        return draw_section(folder, view, model.mesh, setting, progress)
    return draw_surface(folder, view, model.mesh, surface, setting, progress)


def tiff_hint() -> list[str]:
    """Say that drawings are no GeoTIFF, where rasterio is missing."""
    if has_rasterio():
        return []
    return [
        "orthophotos and reliefs are TIFF with a world file, as rasterio is not installed, which writes GeoTIFF:"
        " pip install 'colmap-ihe[survey]'"
    ]


def warned(error: KnownError) -> str:
    """Return an error as a warning."""
    return f"no drawings: {error} ({error.hint})" if error.hint else f"no drawings: {error}"
