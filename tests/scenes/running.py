"""Follow a run in another process by the records that it leaves, and stop one in this."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.progress import Silent

LONG = 120  # seconds; nothing here takes a tenth of it


class StopsWhen(Silent):
    """Cancels once a condition holds, told how many units are done."""

    def __init__(self, condition: Callable[[int], object]) -> None:
        super().__init__()
        self.condition, self.done, self.total = condition, 0, 0

    def start(self, total: int, unit: str = "images") -> None:
        self.total = total

    def advance(self, count: int = 1) -> None:
        self.done += count
        self.check()

    def check(self) -> None:
        if self.condition(self.done):
            raise Cancelled


def wait_until_begun(process: subprocess.Popen[str], project: Path, stage: str) -> None:
    begun, end = project / "records" / f"{stage}.begun.json", time.monotonic() + LONG
    while not begun.exists():
        assert process.poll() is None, f"it ended before {stage}: {process.communicate()}"
        assert time.monotonic() < end
        time.sleep(0.002)
