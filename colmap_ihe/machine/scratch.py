"""Folders for what is under way, in the system's folder for temporary files. They go with their process: at its end,
or after a crash when the next one looks.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from colmap_ihe.errors import DiskFullError
from colmap_ihe.machine.files import room_on_disk
from colmap_ihe.machine.system import has_lock, is_of_another_user, open_to_lock

_NAME = "colmap-ihe-scratch-"
_LOOK_SECONDS = 0.01


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


def _remove_if_dead(folder: Path) -> None:
    if is_of_another_user(folder) or not folder.is_dir():
        return
    lock = open_to_lock(folder)
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
                lock = open_to_lock(folder)
        except FileNotFoundError as error:
            if Path(parent).is_dir():  # swept, before it was locked
                continue
            raise DiskFullError(
                f"{parent}: no such folder for temporary files",
                hint="name one in the environment variable TMPDIR",
            ) from error
        with suppress(OSError):  # a disk without locks: then nothing there is ever swept
            while not has_lock(lock):  # for the moment that another process looks
                time.sleep(_LOOK_SECONDS)
        if folder.exists():
            return folder, lock
        os.close(lock)  # swept, before it was locked
