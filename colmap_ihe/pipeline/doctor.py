"""What is installed, what this machine can do, and what a project will take of it."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import cuda_devices, pycolmap
from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.dense.cost import dense_cost
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.libraries import __version__
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.survey import survey
from colmap_ihe.pipeline import resource_check as foreseen
from colmap_ihe.pipeline.resource_needs import PhotoSetSize, needs_of
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import project_options


def doctor(
    project: Path | None = None, assignments: Sequence[str] = (), images: Path | None = None
) -> dict[str, Any]:
    """What is installed, and what will run where; with a project also what its stages will take of memory and disk, and
    its dense stereo if every photograph gets a place. Raises `KnownError`s of the project."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0
    packages = ("numpy", "opencv-python-headless", "rawpy", "pillow")
    return {
        "colmap-ihe": __version__,
        "python": platform.python_version(),
        "pycolmap": f"{pycolmap.__version__} ({pycolmap.COLMAP_version})",
        **{name: metadata.version(name) for name in packages},
        "cores": local_workers(),
        "memory_gb": round(total / 1e9, 1),
        "free_disk_gb": round(shutil.disk_usage(_nearest(project or Path.cwd())).free / 1e9, 1),
        "cuda": bool(pycolmap.has_cuda),
        "cuda_devices": cuda_devices(),
        "dense_backend": pick_backend("auto"),
        **(_demands(project, assignments, images) if project is not None else {}),
    }


def _nearest(folder: Path) -> Path:
    """The folder, or of those above it the first that is there."""
    place = folder.absolute()
    return next(one for one in (place, *place.parents) if one.is_dir())


def _demands(project: Path, assignments: Sequence[str], images: Path | None) -> dict[str, Any]:
    place, options = Project.at(project, images), project_options(project, list(assignments))
    captures = discover(place.images).captures
    with local_executor() as executor:
        surveyed, _ = survey(captures, executor, SILENT, strict=False)
    sizes = [(one.width, one.height) for one in surveyed]
    found = {one.stage: one for one in needs_of(options, PhotoSetSize.of_survey(surveyed))}
    backend, size = pick_backend(options.dense.backend), options.dense.max_image_size
    dense = dense_cost(sizes, size, backend, local_workers(), memory.available())
    return {
        **{f"{name}_will_take": foreseen.in_words(one) for name, one in found.items()},
        "memory_needed_gb": round(max(one.memory_bytes(1) for one in found.values()) / 1e9, 2),
        "disk_needed_gb": round(
            sum(foreseen.disk_left(place, list(found.values()), found).values()) / 1e9, 2
        ),
        **(dense.as_dict() if options.dense.enabled else {}),
    }
