"""Tell what is installed, what this machine can do, and what a project will take of it."""

from __future__ import annotations

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
from colmap_ihe.machine.system import machine_memory
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.photographs.survey import survey
from colmap_ihe.pipeline.estimates import disk_left, in_words, most_bytes, needs_of
from colmap_ihe.pipeline.resource_needs import PhotoSetSize
from colmap_ihe.pipeline.verdict import about, in_general, minutes_of, of_project
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import project_options


def doctor(
    project: Path | None = None, assignments: Sequence[str] = (), images: Path | None = None
) -> dict[str, Any]:
    """Return what is installed, and what will run where; with a project also the memory and disk that its stages will
    take, and its dense stereo if every photograph is registered. Raises `KnownError`s of the project."""
    folder = _nearest(project or Path.cwd())
    total, _ = machine_memory()
    packages = ("numpy", "opencv-python-headless", "rawpy", "pillow")
    return {
        "colmap-ihe": __version__,
        "python": platform.python_version(),
        "pycolmap": f"{pycolmap.__version__} ({pycolmap.COLMAP_version})",
        **{name: metadata.version(name) for name in packages},
        "cores": local_workers(),
        "memory_gb": round(total / 1e9, 1),
        "free_disk_gb": round(shutil.disk_usage(folder).free / 1e9, 1),
        "cuda": bool(pycolmap.has_cuda),
        "cuda_devices": cuda_devices(),
        "dense_backend": pick_backend("auto"),
        **(_needs(project, assignments, images) if project is not None else {"verdict": in_general(folder)}),
    }


def _nearest(folder: Path) -> Path:
    """Return the folder, or the first above it that is there."""
    return next(path for path in (folder.absolute(), *folder.absolute().parents) if path.is_dir())


def _needs(project: Path, assignments: Sequence[str], images: Path | None) -> dict[str, Any]:
    folder, options = Project.at(project, images), project_options(project, list(assignments))
    captures = find_photographs(folder.images).captures
    with local_executor() as executor:
        surveyed, _ = survey(captures, executor, SILENT, strict=False)
    sizes = [(s.width, s.height) for s in surveyed]
    size_of_set = PhotoSetSize.of_survey(surveyed)
    needs, minutes = needs_of(options, size_of_set), minutes_of(options, size_of_set)
    left = disk_left(folder, needs, [stage.stage for stage in needs])
    backend, size = pick_backend(options.dense.backend), options.dense.max_image_size
    dense = dense_cost(sizes, size, backend, local_workers(), memory.available())
    return {
        **{
            f"{stage.stage}_will_take": in_words(stage) + about(minutes.get(stage.stage, 0.0))
            for stage in needs
        },
        "memory_needed_gb": round(max(map(most_bytes, needs)) / 1e9, 2),
        "disk_needed_gb": round(sum(left.values()) / 1e9, 2),
        "minutes_needed": round(sum(minutes.values()), 1),
        **(dense.as_dict() if options.dense.enabled else {}),
        "verdict": of_project(needs, sum(left.values()), sum(minutes.values()), folder.root),
    }
