"""Digest the user's photographs, masks and calibration frames, to tell whether something changed. The digest of a
file is read again where its size, its times or its place on the disk have changed, and where a change could hide:
the clock of the disk may be coarse, slow or have been set back.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.files import digest_file, read_json
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.discover import Discovery, is_foreign
from colmap_ihe.project.folder import Project

_HIDING_NS = 3 * 10**9
"""How soon after a file was read a change may carry the time that it had: FAT counts in steps of 2 s."""
FRAMES = "../calibration/"  # before the names of its files, which no photograph can have


MASK_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def mask_files(folder: Path) -> list[str]:
    """Return the names of all pictures below a folder, sorted; none if there is no such folder."""
    files = [p for p in folder.rglob("*") if p.suffix.lower() in MASK_SUFFIXES and p.is_file()]
    names = (p.relative_to(folder) for p in files)
    return sorted(name.as_posix() for name in names if not is_foreign(name))


def masks_in(folder: Path) -> dict[str, str]:
    """Return the digest of every picture below a folder, by name; none if there is no such folder."""
    return {name: digest_file(folder / name) for name in mask_files(folder)}


def digest_if_there(file: Path) -> str:
    """Return the digest of a file that an option names, empty where it cannot be read: whoever needs it says so."""
    try:
        return digest_file(file)
    except OSError:
        return ""


def digests_of(
    project: Project, discovery: Discovery, executor: Executor, progress: Progress
) -> dict[str, list[Any]]:
    """Return size, times, inode, time of reading and content digest of each photograph and calibration frame."""
    known = read_json(project.digests_file) or {}
    files = {c.name: c.path for c in discovery.captures}
    for frame in sorted(p for p in project.calibration.rglob("*") if p.is_file() and p.name[0] != "."):
        files[FRAMES + frame.relative_to(project.calibration).as_posix()] = frame
    progress.start(len(files))
    digests: dict[str, list[Any]] = {name: [] for name in files}
    changed = []
    for name, path in files.items():
        old = known.get(name, [])
        if _still_holds(old, path):
            digests[name] = old
            progress.advance()
        else:
            changed.append(name)
    about = in_order(executor, _about, [files[name] for name in changed], progress=progress)
    for name, values in zip(changed, about, strict=True):
        digests[name] = values
        progress.advance()
    return digests


def require_unchanged(
    discovery: Discovery, digests: Mapping[str, Sequence[Any]], names: Collection[str]
) -> None:
    """Raise `ProjectError` if one of these photographs, which were left out, changed since the run began: then a disk
    that went was the reason, and not the photograph."""
    for capture in discovery.captures:
        if capture.name in names and _about(capture.path)[-1] != digests[capture.name][-1]:
            raise ProjectError(
                f"{capture.path}: changed while it was worked on, or its disk went",
                hint="see that the disk is connected and nobody writes there; the same command goes on from here",
            )


def _stamp(path: Path) -> list[int]:
    """Return size, times of change of the content and of anything, inode. The second time is the system's own:
    programs that copy or edit cannot set it. Raises OSError."""
    about = path.stat()
    return [about.st_size, about.st_mtime_ns, about.st_ctime_ns, about.st_ino]


def _still_holds(known: Any, path: Path) -> bool:
    """Tell whether what is known of a file is of what it holds now."""
    try:
        *stamp, read_ns, digest = known
        _, modified, changed, _ = stamp
        hidden = changed > read_ns - _HIDING_NS or abs(read_ns - modified) < _HIDING_NS
        return isinstance(digest, str) and not hidden and stamp == _stamp(path)
    except (OSError, ValueError, TypeError):
        return False


def _about(path: Path) -> list[Any]:
    read_ns = time.time_ns()  # by the clock of this machine, which need not be that of the disk
    try:
        return [*_stamp(path), read_ns, digest_file(path)]
    except OSError as error:
        return [0, 0, 0, 0, 0, f"unreadable: {error.strerror}"]
