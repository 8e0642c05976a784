"""Look at a project before it runs: whether it needs to, and how much memory it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from colmap_ihe.errors import KnownError, PhotographError
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.preview import small_picture
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.photographs.survey import Surveyed, survey
from colmap_ihe.pipeline.estimates import needs_of
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.resource_needs import PhotoSetSize
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import project_options
from colmap_ihe.report import pictures
from colmap_ihe.report.contents import Picture

_THUMBNAIL = 240  # pixels


@dataclass(frozen=True)
class ProjectPreview:
    """Hold the number of photographs, their pixels in all, and the bytes of memory that a run takes. `up_to_date`:
    nothing is to be done, and the memory is 0. `reason`, `hint`: why it cannot run at all."""

    photographs: int = 0
    pixels: int = 0
    memory_bytes: int = 0
    up_to_date: bool = False
    reason: str = ""
    hint: str = ""
    thumbnail: Picture | None = None


def preview_project(root: Path, assignments: Sequence[str]) -> ProjectPreview:
    """Look at a project. Whatever is wrong with it is in the preview: nothing is raised for it."""
    captures: Sequence[Capture] = ()
    thumbnail = None
    try:
        project, options = Project.at(root), project_options(root, list(assignments))
        captures = find_photographs(project.images).captures
        thumbnail = _thumbnail(captures)
        if _is_up_to_date(project, options):
            record = read_record(project, "captures") or {}
            pixels = int(record.get("pixels", 0))
            return ProjectPreview(len(captures), pixels, up_to_date=True, thumbnail=thumbnail)
        with local_executor() as executor:
            surveyed, _ = survey(captures, executor, SILENT, strict=False)
    except KnownError as error:
        return ProjectPreview(len(captures), reason=str(error), hint=error.hint, thumbnail=thumbnail)
    except Exception as error:  # noqa: BLE001  of one project, and the others go on
        return ProjectPreview(reason=f"it could not be looked at: {type(error).__name__}: {error}")
    pixels = sum(photograph.width * photograph.height for photograph in surveyed)
    return ProjectPreview(len(captures), pixels, _memory_bytes(surveyed, options), thumbnail=thumbnail)


def _memory_bytes(surveyed: Sequence[Surveyed], options: Options) -> int:
    """Return the memory of the stage that takes most, with a worker a core."""
    stages, workers = needs_of(options, PhotoSetSize.of_survey(surveyed)), local_workers()
    return max(max(stage.memory_bytes(workers), stage.base_bytes + stage.more_bytes) for stage in stages)


def _is_up_to_date(project: Project, options: Options) -> bool:
    if not project.page_file.exists() or not project.summary_file.exists() or options.captures.strict:
        return False
    stages = status(project.root, options)
    return all(stage.state == "off" or (stage.state == "done" and not stage.why) for stage in stages)


def _thumbnail(captures: Sequence[Capture]) -> Picture | None:
    """Return a small picture of the photograph in the middle of the set, or of the next one that can be read."""
    middle = len(captures) // 2
    for capture in [*captures[middle:], *captures[:middle]][:3]:
        try:
            pixels = small_picture(capture, _THUMBNAIL)
        except PhotographError:
            continue
        return pictures.picture(np.asarray(pixels), f"Photograph {capture.name}", _THUMBNAIL)
    return None
