"""Program that looks into a COLMAP database: `check DATABASE`, or `count DATABASE TABLE`.

Never in the process that runs COLMAP: two SQLite libraries in one process drop each other's file locks,
which ends in a bus error (sqlite.org, "How to corrupt an SQLite database file", 2.2.1). It imports the standard
library only.
"""

from __future__ import annotations

import sqlite3
import sys
import time
from contextlib import closing, suppress
from pathlib import Path

_EVERY_SECONDS = 0.5


def is_sound(database: Path) -> bool:
    """Tell whether SQLite finds the file whole."""
    try:
        with closing(sqlite3.connect(database)) as connection:
            return bool(connection.execute("PRAGMA quick_check").fetchone() == ("ok",))
    except sqlite3.Error:
        return False


def rows_in(database: Path, table: str) -> int:
    """Return the number of rows of a table so far, 0 while there is none."""
    try:
        uri = f"{database.absolute().as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, uri=True, timeout=0.1)) as connection:
            return int(connection.execute(f'SELECT COUNT(*) FROM "{table}"').fetchone()[0])
    except sqlite3.Error:
        return 0


def main() -> None:
    """Exit with status 0 if the database is sound; or print its rows until nobody reads them."""
    mode, database = sys.argv[2], Path(sys.argv[3])
    if mode == "check":
        sys.exit(0 if is_sound(database) else 1)
    with suppress(BrokenPipeError):
        while True:
            print(rows_in(database, sys.argv[4]), flush=True)
            time.sleep(_EVERY_SECONDS)
