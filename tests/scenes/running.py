"""Follow a run in another process by the records that it leaves."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

LONG = 120  # seconds; nothing here takes a tenth of it


def wait_until_begun(process: subprocess.Popen[str], project: Path, stage: str) -> None:
    begun, end = project / "records" / f"{stage}.begun.json", time.monotonic() + LONG
    while not begun.exists():
        assert process.poll() is None, f"it ended before {stage}: {process.communicate()}"
        assert time.monotonic() < end
        time.sleep(0.002)
