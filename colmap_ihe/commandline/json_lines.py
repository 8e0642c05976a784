"""A run as lines of JSON on stdout, for programs that follow it: one object a line, with what happened in `event`."""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

from colmap_ihe.commandline.display import Display, StageDisplay, printable

_EVERY_SECONDS = 1.0


class JsonLines(Display):
    """docs/terminal.md lists the events and their fields."""

    def __init__(self) -> None:
        super().__init__()
        self._writing = threading.Lock()

    def say(self, event: str, **values: Any) -> None:
        with self._writing:
            print(json.dumps({"event": event, **values}, ensure_ascii=False), flush=True)

    def warn(self, text: str) -> None:
        self.say("warning", text=text)

    def result(self, text: str) -> None:
        self.say("result", result=json.loads(text))

    def failed(self, message: str, hint: str) -> None:
        self.say("failed", message=message, hint=hint)
        print(printable(f"colmap-ihe: {message}{f' ({hint})' if hint else ''}"), file=sys.stderr)

    def _piece(self, name: str) -> StageDisplay:
        self.say("stage", stage=name)
        return _Lines(self, name)

    def _kept(self, name: str) -> None:
        self.say("kept", stage=name)


class _Lines(StageDisplay):
    def __init__(self, lines: JsonLines, name: str) -> None:
        super().__init__(lines, name)
        self._lines = lines
        self._told = 0.0

    def _started(self) -> None:
        self._tell()

    def _advanced(self) -> None:
        if self.done == self.total or time.monotonic() > self._told + _EVERY_SECONDS:
            self._tell()

    def _tell(self) -> None:
        self._told = time.monotonic()
        stage, run = (None if s is None else round(s, 1) for s in self.left_s())
        self._lines.say(
            "progress",
            stage=self.name,
            unit=self.unit,
            done=self.done,
            total=self.total,
            stage_seconds_left=stage,
            run_seconds_left=run,
        )

    def over(self, seconds: float) -> None:
        self._lines.say("done", stage=self.name, seconds=round(seconds, 2))

    def close(self) -> None:
        pass
