"""The COLMAP database of a project: kept only for the grey images it was made from."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path


def remove_database(path: Path) -> None:
    """Removes a database with the side files that SQLite keeps beside it."""
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def database_is_sound(path: Path) -> bool:
    """Whether SQLite finds the file whole: after a kill it may be there and not be a database."""
    try:
        with closing(sqlite3.connect(path)) as connection:
            return bool(connection.execute("PRAGMA quick_check").fetchone() == ("ok",))
    except sqlite3.Error:
        return False


def rows_in(path: Path, table: str) -> int:
    """Rows of a table so far, 0 while there is none; for progress, while COLMAP is writing."""
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=0.1)) as connection:
            return int(connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
    except sqlite3.Error:
        return 0
