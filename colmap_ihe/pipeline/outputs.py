"""What each stage leaves in a project: whether it is still there as it was left, and how it is removed.

`remove` is called before a stage is noted as begun, so that a stage that is found begun has never anything of
an earlier input under its final names.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.database import looks_whole, remove_database
from colmap_ihe.colmap.matching import VOCABULARY, forget_matches
from colmap_ihe.machine.files import quick_digest
from colmap_ihe.machine.files import remove_unfinished as _remove_unfinished
from colmap_ihe.project.folder import Project
from colmap_ihe.project.recipe import FILES


def remove(stage: str, project: Project) -> None:
    """Removes what `stage` has made, and what is left of unfinished work."""
    if stage == "fit":
        project.histogram_file.unlink(missing_ok=True)
    elif stage == "convert":
        shutil.rmtree(project.grey, ignore_errors=True)
        shutil.rmtree(project.colour, ignore_errors=True)
    elif stage == "features":
        remove_database(project.database)
    elif stage == "matches" and project.database.exists():
        forget_matches(project.database)
    elif stage == "sparse":
        for folder in (project.sparse, *project.workspace.glob(".sparse.*")):
            shutil.rmtree(folder, ignore_errors=True)
    elif stage == "dense":
        shutil.rmtree(project.dense, ignore_errors=True)
    elif stage == "mesh":
        for file in project.dense.glob("mesh.*"):
            file.unlink(missing_ok=True)


def bytes_of(stage: str, project: Project) -> int:
    """Bytes of what `stage` has made, or a part of it, on the disk."""
    mesh = list(project.dense.glob("mesh.*"))
    places = {
        "fit": [project.histogram_file],
        "convert": [project.grey, project.colour],
        "features": [project.database],
        "sparse": [project.sparse],
        "dense": [project.dense],
        "mesh": mesh,
        "page": [project.report],
    }.get(stage, [])
    size = sum(map(_size_of, places))
    return size - sum(map(_size_of, mesh)) if stage == "dense" else size


def _size_of(place: Path) -> int:
    if place.is_file():
        return place.stat().st_size
    return sum(file.stat().st_size for file in place.rglob("*") if file.is_file())


def remove_unfinished(project: Project) -> None:
    """Removes what a run or a worker that was killed left half-written. Nobody else may be at it."""
    for folder in (*project.made_folders, project.records):
        _remove_unfinished(folder)
    for folder in project.workspace.glob(".*.old"):
        shutil.rmtree(folder, ignore_errors=True)
    for file in project.dense.glob("*.part.ply*"):
        file.unlink(missing_ok=True)
    shutil.rmtree(project.dense / "stereo" / ".cell", ignore_errors=True)
    (project.workspace / VOCABULARY).unlink(missing_ok=True)


def remove_masters(project: Project, recipes: Mapping[str, Mapping[str, Any]]) -> None:
    """Removes means of calibration frames that no recipe names any more."""
    for file in project.masters.glob("*.npy"):
        if file.name not in _named(recipes):
            file.unlink()


def _named(recipes: Mapping[str, Mapping[str, Any]]) -> set[str]:
    return {recipe[key] for recipe in recipes.values() for key in FILES if key in recipe}


def files_of(stage: str, project: Project, record: Mapping[str, Any]) -> list[Path]:
    """What a finished stage has left, and what comes after it needs."""
    if stage == "captures":
        return [project.masters / name for name in sorted(_named(record["recipes"]))]
    if stage == "convert":
        folders = (project.grey, project.colour)
        return [folder / name for name in record["grey"].values() for folder in folders]
    if stage in ("features", "matches"):
        return [project.database]
    if stage == "sparse":
        names = ("cameras.bin", "images.bin", "points3D.bin")
        return [project.sparse / str(n) / name for n in range(len(record["models"])) for name in names]
    if stage == "dense":
        return [project.dense / "fused.ply"]
    if stage == "mesh":
        return [project.dense / name for name in record["files"]]
    return []


def missing(stage: str, project: Project, record: Mapping[str, Any]) -> list[Path]:
    """The files of a finished stage that are no longer there."""
    return [file for file in files_of(stage, project, record) if not file.is_file()]


def made_by(stage: str, project: Project, record: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Size, time and sketch of every file that a stage has just left, by its path in the project. Not of the
    database: stages share it, and COLMAP's own GUI writes into it when it is only looked at."""
    files = [] if stage in ("features", "matches") else files_of(stage, project, record)
    return {file.relative_to(project.root).as_posix(): [*_state(file), quick_digest(file)] for file in files}


def altered(stage: str, project: Project, record: Mapping[str, Any]) -> list[Path]:
    """The files of a finished stage that are there and are not what it has left."""
    if stage == "features":
        return [] if looks_whole(project.database) else [project.database]
    made: Mapping[str, list[Any]] = record.get("made", {})
    files = {project.root / name: was for name, was in made.items() if (project.root / name).is_file()}
    return [file for file, was in files.items() if _state(file) != was[:2] and quick_digest(file) != was[2]]


def set_aside(stage: str, project: Project, record: Mapping[str, Any]) -> list[Path]:
    """Moves what somebody has altered out of the way of a stage that is to run again; where it is now."""
    moved = []
    for file in altered(stage, project, record) if stage != "features" else ():
        aside = project.set_aside / file.relative_to(project.root)
        number = 1
        while aside.exists():
            number += 1
            aside = aside.with_name(f"{file.stem} ({number}){file.suffix}")
        aside.parent.mkdir(parents=True, exist_ok=True)
        file.rename(aside)
        moved.append(aside)
    return moved


def _state(file: Path) -> list[int]:
    about = file.stat()
    return [about.st_size, about.st_mtime_ns]
