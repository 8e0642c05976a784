"""Marks on the folders that this package made, and locks on those that somebody works in."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import IO

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.system import AT_ONCE, has_lock

_WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
MARK = ".made-by-colmap-ihe"


def is_marked(folder: Path) -> bool:
    """Tell whether `folder` bears our mark, so that nothing in it is the user's."""
    return (folder / MARK).exists()


def refuse_unmarked(folder: Path, hint: str) -> None:
    """Raise `ProjectError` if there is something at `folder` that we did not make."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ProjectError(f"{folder}: is there already and was not made by colmap-ihe", hint=hint)


def make(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MARK).touch()


def acquire_lock(file: Path) -> IO[str] | None:
    """Return the lock that goes with `file`, held until what is returned is closed or the process ends, however that
    happens; None if somebody else has it. Raises `ProjectError` for a disk without locks, OSError."""
    file.parent.mkdir(parents=True, exist_ok=True)
    # not to wait for the other end, were it a pipe
    opened = os.open(file, os.O_RDWR | os.O_APPEND | os.O_CREAT | AT_ONCE, 0o666)
    handle = os.fdopen(opened, "a")
    try:
        locked = lock_at_once(opened, file.parent)
    except BaseException:
        handle.close()
        raise
    if not locked:
        handle.close()
        return None
    return handle


def lock_at_once(descriptor: int, folder: Path) -> bool:
    """Take the lock on an open file in `folder`, or on the folder itself; return False if somebody else has it. Raises
    `ProjectError` for a disk without locks, OSError."""
    try:
        return has_lock(descriptor)
    except OSError as error:
        if error.errno not in _WITHOUT_LOCKS:
            raise
        raise ProjectError(
            f"{folder}: its disk has no locks ({error.strerror}), and without them two runs would spoil each other's"
            " files, and COLMAP its database",
            hint="work in a folder on a disk of this machine; the photographs may stay where they are (--images DIR)",
        ) from error
