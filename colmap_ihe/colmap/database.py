"""Check the COLMAP database of a project, and count its rows while COLMAP writes it."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from colmap_ihe.colmap import database_probe

_PROBE = [sys.executable, "-I", str(database_probe.__file__)]


def remove_database(path: Path) -> None:
    """Remove a database with the side files that SQLite keeps beside it."""
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def looks_whole(path: Path) -> bool:
    """Return whether a database has the head and the size of one, at no cost; SQLite's own check where a writer was
    interrupted. True if there is none. (sqlite.org, "Database File Format", 1.3)"""
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
    """Return whether SQLite finds the file whole: after a kill it may exist and not be a database."""
    if not path.exists():
        return False
    # In a session of its own: Ctrl-C in the terminal is for us.
    return subprocess.run([*_PROBE, "check", path], check=False, start_new_session=True).returncode == 0


@contextmanager
def counting_rows(path: Path, table: str) -> Iterator[Callable[[], int]]:
    """Give a function that returns the number of rows of `table` at the last look, twice a second."""
    latest = [0]
    probe = subprocess.Popen(
        [*_PROBE, "count", path, table], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert probe.stdout is not None
    lines = probe.stdout

    def listen() -> None:
        for line in lines:
            latest[0] = int(line)

    listener = threading.Thread(target=listen, name="database probe", daemon=True)
    listener.start()
    try:
        yield lambda: latest[0]
    finally:
        probe.kill()
        probe.wait()
        listener.join()
        lines.close()
