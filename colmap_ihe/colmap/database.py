"""Check the COLMAP database of a project, and count its rows while COLMAP writes it."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from colmap_ihe.errors import NativeError
from colmap_ihe.machine.child_process import ChildProcess

_PROBE = "colmap_ihe.colmap.database_probe"
_TICK_SECONDS = 1.0


def remove_database(path: Path) -> None:
    """Remove a database with the side files that SQLite keeps beside it."""
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def looks_whole(path: Path) -> bool:
    """Tell whether a database has the head and the size of one, at no cost; use SQLite's own check where a writer was
    interrupted. True if there is none: that is another matter. (sqlite.org, "Database File Format", 1.3)"""
    if not path.is_file():
        return True
    if path.with_name(f"{path.name}-wal").exists():
        return database_is_sound(path)
    with path.open("rb") as handle:
        head = handle.read(100)
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0"):
        return False
    page = int.from_bytes(head[16:18], "big")
    pages = int.from_bytes(head[28:32], "big")
    return pages * (65536 if page == 1 else page) == path.stat().st_size


def database_is_sound(path: Path) -> bool:
    """Tell whether SQLite finds the file whole: after a kill it may be there and not be a database."""
    if not path.exists():
        return False
    probe = ChildProcess(_PROBE, "check", str(path))
    try:
        return probe.status(None) == 0
    finally:
        probe.end()


@contextmanager
def counting_rows(path: Path, table: str) -> Iterator[Callable[[], int]]:
    """Give a function that returns how many rows `table` has, as last looked at."""
    latest = [0]
    probe = ChildProcess(_PROBE, "count", str(path), table, piped=True)

    def listen() -> None:
        for line in probe.lines(_TICK_SECONDS):
            latest[0] = int(line or latest[0])

    listener = threading.Thread(target=listen, name="database probe", daemon=True)
    listener.start()
    try:
        yield lambda: latest[0]
    finally:
        probe.kill()
        listener.join()
        probe.end()


@contextmanager
def writing(path: Path) -> Iterator[sqlite3.Connection]:
    """Give the database itself, in one transaction, for what pycolmap does not write: features over others (COLMAP's
    documentation, "Database Format"). Raises `NativeError`; nothing is written then."""
    try:
        with closing(sqlite3.connect(path)) as opened, opened:
            yield opened
    except sqlite3.Error as error:
        raise NativeError(
            f"{path}: features could not be written: {error}",
            hint="check that the disk has room and allows locking; the same command goes on from here",
        ) from error
