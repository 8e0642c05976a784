"""What is in the user's files: digests of photographs, masks and calibration frames, by which the road tells
whether something changed. The digest of a file is read again where its size or times have changed: the time of
its content, which whoever writes it can set, and that of its entry on the disk, which nobody can.
"""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from colmap_ihe.captures.discover import Discovery
from colmap_ihe.executor import in_order
from colmap_ihe.files import digest_file, read_json
from colmap_ihe.progress import Watch
from colmap_ihe.project import Project

FRAMES = "../calibration/"  # before the names of its files, which no photograph can have


def masks_in(folder: Path) -> dict[str, str]:
    """Name and digest of every PNG below a folder; none if there is no such folder."""
    files = sorted(p for p in folder.rglob("*.png") if p.is_file()) if folder.is_dir() else []
    return {p.relative_to(folder).as_posix(): digest_file(p) for p in files}


def digests_of(
    project: Project, discovery: Discovery, executor: Executor, watch: Watch
) -> dict[str, list[Any]]:
    """Size, times and digest of the content of every photograph and calibration frame, read again where size or
    times have changed."""
    known = read_json(project.digests_file) or {}
    files = {c.name: c.path for c in discovery.captures}
    for frame in sorted(p for p in project.calibration.rglob("*") if p.is_file() and p.name[0] != "."):
        files[FRAMES + frame.relative_to(project.calibration).as_posix()] = frame
    watch.start(len(files))
    found: dict[str, list[Any]] = {name: [] for name in files}
    changed = []
    for name, path in files.items():
        old = known.get(name, [])
        if old and old[:-1] == _size_and_times(path):
            found[name] = old
            watch.advance()
        else:
            changed.append(name)
    about = in_order(executor, _about, [files[name] for name in changed], watch=watch)
    for name, values in zip(changed, about, strict=True):
        found[name] = values
        watch.advance()
    return found


def _size_and_times(path: Path) -> list[int]:
    try:
        about = path.stat()
    except OSError:
        return []
    return [about.st_size, about.st_mtime_ns, about.st_ctime_ns]


def _about(path: Path) -> list[Any]:
    try:
        return [*_size_and_times(path), digest_file(path)]
    except OSError as error:
        return [0, 0, 0, f"unreadable: {error.strerror}"]
