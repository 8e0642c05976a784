"""What is known of a project before it runs: whether it needs to, and how much memory and time it will want."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.features import features_bytes
from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.dense.cost import dense_cost
from colmap_ihe.errors import KnownError, PhotographError
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.photographs.preview import small_picture
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

BASE_BYTES = 600_000_000
"""Of any run: the interpreter, the libraries, and COLMAP's caches of a small set. Measured; see docs/batch.md."""
_THUMBNAIL = 240  # pixels


@dataclass(frozen=True)
class ProjectPreview:
    """`up_to_date`: nothing is to be done. `reason`, `hint`: why it cannot run at all. `photographs`, and their
    `pixels` in all; `need_bytes` of memory with a worker a core, 0 if unknown."""

    photographs: int = 0
    pixels: int = 0
    need_bytes: int = 0
    up_to_date: bool = False
    reason: str = ""
    hint: str = ""
    thumbnail: Picture | None = None


def look_at(root: Path, assignments: Sequence[str]) -> ProjectPreview:
    """Whatever is wrong with the project is in the answer: nothing is raised for it."""
    captures: Sequence[Capture] = ()
    thumbnail = None
    try:
        project, options = Project.at(root), project_options(root, list(assignments))
        captures = discover(project.images).captures
        thumbnail = _thumbnail(captures)
        if _is_up_to_date(project, options):
            record = read_record(project, "captures") or {}
            pixels = int(record.get("pixels", 0))
            return ProjectPreview(len(captures), pixels, up_to_date=True, thumbnail=thumbnail)
        with local_executor() as executor:
            surveyed, _ = survey(captures, executor, SILENT, strict=False)
    except KnownError as error:
        return ProjectPreview(len(captures), reason=str(error), hint=error.hint, thumbnail=thumbnail)
    pixels = sum(one.width * one.height for one in surveyed)
    return ProjectPreview(len(captures), pixels, need_of(surveyed, options), thumbnail=thumbnail)


def need_of(surveyed: Sequence[Surveyed], options: Options) -> int:
    """Bytes of memory that a run of these photographs takes at the most, with a worker a core."""
    workers = local_workers()
    sizes = [(one.width, one.height) for one in surveyed]
    needs = [
        memory.needed([one.capture for one in surveyed]) * workers,
        features_bytes(sizes, options.features, workers),
    ]
    if options.dense.enabled:
        backend = pick_backend(options.dense.backend)
        needs.append(dense_cost(sizes, options.dense.max_image_size, backend, workers, 0).memory_bytes)
    demands = needs_of(options, PhotoSetSize.of_survey(surveyed))
    needs += [demand.base_bytes - BASE_BYTES for demand in demands if demand.stage == "mesh"]
    return BASE_BYTES + max(needs)


def _is_up_to_date(project: Project, options: Options) -> bool:
    if not project.page_file.exists() or not project.summary_file.exists() or options.captures.strict:
        return False
    return all(stage.state in ("done", "off") for stage in status(project.root, options))


def _thumbnail(captures: Sequence[Capture]) -> Picture | None:
    """Of the photograph in the middle of the set, or the next one that can be read."""
    middle = len(captures) // 2
    for capture in [*captures[middle:], *captures[:middle]][:3]:
        try:
            pixels = small_picture(capture, _THUMBNAIL)
        except PhotographError:
            continue
        return pictures.picture(np.asarray(pixels), f"Photograph {capture.name}", _THUMBNAIL)
    return None
