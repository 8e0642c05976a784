"""Print a run or a batch as lines of JSON on stdout, one object a line, for programs that follow it."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from colmap_ihe.batch.state import BatchState, ProjectState
from colmap_ihe.commandline.display import StageCounter, failure_line

_STAGE_SECONDS = 1.0  # between two lines of a stage
_BATCH_SECONDS = 10.0  # between two lines of a batch


class JsonLines:
    """Print for a program. docs/terminal.md lists the events and their fields."""

    def __init__(self) -> None:
        self._writing = threading.Lock()
        self._next_stage = self._next_batch = 0.0

    def begin(self, stage: StageCounter) -> None:
        self._print("stage", stage=stage.name)

    def move(self, stage: StageCounter) -> None:
        if 0 < stage.done < stage.total and time.monotonic() < self._next_stage:
            return
        self._next_stage = time.monotonic() + _STAGE_SECONDS
        left, run_left = (_rounded(seconds) for seconds in stage.left_s())
        self._print(
            "progress",
            stage=stage.name,
            unit=stage.unit,
            done=stage.done,
            total=stage.total,
            stage_seconds_left=left,
            run_seconds_left=run_left,
        )

    def end(self, stage: StageCounter, seconds: float | None) -> None:
        if seconds is not None:
            self._print("done", stage=stage.name, seconds=round(seconds, 2))

    def kept(self, name: str) -> None:
        self._print("kept", stage=name)

    def warn(self, text: str) -> None:
        self._print("warning", text=text)

    def show(self, state: BatchState, changed: Sequence[ProjectState]) -> None:
        for project in changed:
            why = {"reason": project.reason, "hint": project.hint}
            self._print("project", project=project.name, state=project.state, **why)
        if time.monotonic() >= self._next_batch:
            self._next_batch = time.monotonic() + _BATCH_SECONDS
            left = _rounded(state.remaining_s)
            self._print("batch", ended=state.ended, projects=len(state.projects), seconds_left=left)

    def result(self, text: str) -> None:
        self._print("result", result=json.loads(text))

    def failed(self, message: str, hint: str) -> None:
        self._print("failed", message=message, hint=hint)
        print(failure_line(message, hint), file=sys.stderr)

    def _print(self, event: str, **values: Any) -> None:
        with self._writing:
            print(json.dumps({"event": event, **values}, ensure_ascii=False), flush=True)


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 1)
