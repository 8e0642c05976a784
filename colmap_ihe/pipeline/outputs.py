"""Look after what each stage leaves in a project: whether it is still as it was left, and how it is removed.

A stage's files are removed before it is noted as begun, so that one that is found begun has never anything of an
earlier input under its final names.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.matching import VOCABULARY
from colmap_ihe.machine import files
from colmap_ihe.machine.files import quick_digest
from colmap_ihe.pipeline.stage import Record, Stage
from colmap_ihe.project.folder import Project


def remove(stage: Stage, project: Project) -> None:
    """Remove what a stage has made, and what is left of unfinished work."""
    if stage.remove is not None:
        stage.remove(project)
        return
    for path in stage.made(project):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    if path.is_file():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def remove_unfinished(project: Project) -> None:
    """Remove what a run or a worker that was killed left half-written. Nobody else may be at it."""
    for folder in (*project.made_folders, project.records):
        files.remove_unfinished(folder)
    for folder in project.workspace.glob(".*.old"):
        shutil.rmtree(folder, ignore_errors=True)
    for file in project.dense.glob("*.part.ply*"):
        file.unlink(missing_ok=True)
    shutil.rmtree(project.dense / "stereo" / ".cell", ignore_errors=True)
    (project.workspace / VOCABULARY).unlink(missing_ok=True)


def missing(stage: Stage, project: Project, record: Record) -> list[Path]:
    """Return the files of a finished stage that are no longer there."""
    return [file for file in stage.files(project, record) if not file.is_file()]


def states_of(stage: Stage, project: Project, record: Record) -> dict[str, list[Any]]:
    """Return size, time and quick digest of every file that a stage has just left, by its path in the project. Not of
    the database: stages share it, and COLMAP's own GUI writes into it when it is only looked at."""
    left = [] if stage.is_sound else stage.files(project, record)
    return {file.relative_to(project.root).as_posix(): [*_stamp(file), quick_digest(file)] for file in left}


def altered(stage: Stage, project: Project, record: Record) -> list[Path]:
    """Return the files of a finished stage that are there and are not what it has left."""
    if stage.is_sound is not None:
        return [] if stage.is_sound(project) else stage.files(project, record)
    states = {project.root / name: state for name, state in record.get("made", {}).items()}
    return [
        file
        for file, state in states.items()
        if file.is_file() and _stamp(file) != state[:2] and quick_digest(file) != state[2]
    ]


def set_aside(stage: Stage, project: Project, record: Record) -> list[Path]:
    """Move files that somebody has altered out of the way of a stage that is to run again; return where they are."""
    moved = []
    for file in () if stage.is_sound else altered(stage, project, record):
        aside = project.set_aside / file.relative_to(project.root)
        number = 1
        while aside.exists():
            number += 1
            aside = aside.with_name(f"{file.stem} ({number}){file.suffix}")
        aside.parent.mkdir(parents=True, exist_ok=True)
        file.rename(aside)
        moved.append(aside)
    return moved


def _stamp(file: Path) -> list[int]:
    about = file.stat()
    return [about.st_size, about.st_mtime_ns]
