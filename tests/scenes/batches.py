"""Folders of projects for tests of batches, and a display that notes what it is shown."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from colmap_ihe.batch.state import BatchState
from colmap_ihe.errors import Cancelled


class Listener:
    """Note the states of a batch, and stop it when `until` holds; fail after `most` seconds."""

    def __init__(self, until: Callable[[BatchState], bool] = lambda _state: False, most: float = 60) -> None:
        self.states: list[BatchState] = []
        self.warnings: list[str] = []
        self._until, self._end = until, time.monotonic() + most

    def check(self) -> None:
        assert time.monotonic() < self._end, self.states[-1]
        if self.states and self._until(self.states[-1]):
            raise Cancelled

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def show(self, state: BatchState) -> None:
        self.states.append(state)


def projects(root: Path, *names: str) -> Path:
    for name in names:
        (root / name / "images").mkdir(parents=True)
        (root / name / "images/a.jpg").touch()
    return root


def states(state: BatchState) -> dict[str, str]:
    return {project.name: project.state for project in state.projects}
