"""Folders for what is under way, in the system's folder for temporary files. They go with their process: at its end,
or after a crash when the next one looks.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from colmap_ihe.errors import DiskFullError
from colmap_ihe.machine.files import room_on_disk
from colmap_ihe.machine.locks import has_lock

_NAME = "colmap-ihe-scratch-"


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Give an empty folder while this lasts. A lock on it tells that its process lives; the kernel drops the lock
    however that process ends. Raises `DiskFullError` where there can be none."""
    sweep()
    folder, lock = _made()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def sweep() -> None:
    """Remove the folders of processes that are no more. One that cannot be looked at or locked is left."""
    with suppress(OSError):
        for folder in Path(tempfile.gettempdir()).glob(f"{_NAME}*"):
            with suppress(OSError):
                _remove_if_dead(folder)


def anonymous_file() -> int:
    """Return the descriptor of a file in memory, or where the system has none, of one on disk without a name."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("colmap-ihe", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _remove_if_dead(folder: Path) -> None:
    if folder.lstat().st_uid != os.getuid():
        return
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        if has_lock(lock):
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(lock)


def _made() -> tuple[Path, int]:
    """Make a folder: return it and the lock on it."""
    parent = tempfile.gettempdir()
    while True:
        try:
            with room_on_disk(Path(parent)):
                folder = Path(tempfile.mkdtemp(prefix=_NAME))
                lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except FileNotFoundError as error:
            if Path(parent).is_dir():  # swept, before it was locked
                continue
            raise DiskFullError(
                f"{parent}: no such folder for temporary files",
                hint="name one in the environment variable TMPDIR",
            ) from error
        with suppress(OSError):  # a disk without locks: then nothing there is ever swept
            fcntl.flock(lock, fcntl.LOCK_EX)
        if _is_at(folder, lock):
            return folder, lock
        os.close(lock)  # swept, before it was locked


def _is_at(folder: Path, lock: int) -> bool:
    try:
        return os.path.samestat(folder.stat(), os.fstat(lock))
    except FileNotFoundError:
        return False
