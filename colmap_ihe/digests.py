"""What is in the user's files: digests of photographs, masks and calibration frames, by which the road tells
whether something changed. The digest of a file is read again where its size or time have changed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from colmap_ihe.captures.discover import Discovery
from colmap_ihe.progress import Watch
from colmap_ihe.project import Project, digest_file, read_json

FRAMES = "../calibration/"  # before the names of its files, which no photograph can have


def content_of(folder: Path) -> list[list[str]]:
    """Name and digest of every file of a folder, in order; empty if there is no such folder."""
    files = sorted(p for p in folder.rglob("*") if p.is_file()) if folder.is_dir() else []
    return [[p.relative_to(folder).as_posix(), digest_file(p)] for p in files]


def digests_of(project: Project, discovery: Discovery, watch: Watch) -> dict[str, list[Any]]:
    """Size, time and digest of the content of every photograph and calibration frame, read again where size or
    time have changed."""
    known = read_json(project.digests_file) or {}
    found: dict[str, list[Any]] = {}
    files = {c.name: c.path for c in discovery.captures}
    for frame in sorted(p for p in project.calibration.rglob("*") if p.is_file()):
        files[FRAMES + frame.relative_to(project.calibration).as_posix()] = frame
    watch.start(len(files))
    for name, path in files.items():
        try:
            about = path.stat()
            key = [about.st_size, about.st_mtime_ns]
            old = known.get(name, [])
            found[name] = [*key, old[2] if old[:2] == key else digest_file(path)]
        except OSError as error:
            found[name] = [0, 0, f"unreadable: {error.strerror}"]
        watch.advance()
    return found
