"""Processes as the system sees them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path


def stat_of(pid: int | str) -> list[str]:
    """The fields of /proc/PID/stat from the state on; empty for one that is not there."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return []


def children(of: int | None = None) -> list[int]:
    """Processes whose parent is this one (or `of`), zombies among them."""
    pids = [int(folder.name) for folder in Path("/proc").glob("[0-9]*")]
    return [pid for pid in pids if stat_of(pid)[1:2] == [str(of or os.getpid())]]


def is_gone(pid: int) -> bool:
    """Whether it ended; a zombie has, for whoever is its parent."""
    return stat_of(pid)[:1] in ([], ["Z"])


def soon(condition: Callable[[], bool], seconds: float = 20) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.01)
    return condition()
