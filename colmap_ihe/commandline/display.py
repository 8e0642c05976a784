"""Follow a run or a batch: count what is done, estimate what remains, stop when asked. A `Screen` prints it."""

from __future__ import annotations

import threading
import time
import unicodedata
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from colmap_ihe.batch.state import BatchState, ProjectState
from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Forecast, Part

_JOINERS = "\u200c\u200d"


def printable(text: str) -> str:
    """Return text without the characters that would steer a terminal, which a photograph or a file may hold."""
    text = text.translate(dict.fromkeys(map(ord, "\t\n\r"), " "))
    return "".join(c if _is_plain(c) else c.encode("unicode_escape").decode() for c in text)


def _is_plain(character: str) -> bool:
    """Tell a character that shows, a space of any script, or one that joins letters or keeps them apart."""
    return character.isprintable() or unicodedata.category(character) == "Zs" or character in _JOINERS


def failure_line(message: str, hint: str) -> str:
    """Return the line on stderr with which a command ends that failed."""
    return printable(f"colmap-ihe: {message}{f' ({hint})' if hint else ''}")


class Screen(Protocol):
    """Print what a `Display` knows, for a person or for a program."""

    def begin(self, stage: StageCounter) -> None:
        """Show that a stage begins."""

    def move(self, stage: StageCounter) -> None:
        """Show how far a stage is; 0 units are done where it, or its next part, starts to count."""

    def end(self, stage: StageCounter, seconds: float | None) -> None:
        """Show that a stage took so long; None if it broke off."""

    def kept(self, name: str) -> None:
        """Show that a stage is up to date."""

    def warn(self, text: str) -> None:
        """Print a warning, one line."""

    def show(self, state: BatchState, changed: Sequence[ProjectState]) -> None:
        """Show a batch, and those of its projects whose state changed."""

    def result(self, text: str) -> None:
        """Print the result of the command, JSON text."""

    def failed(self, message: str, hint: str) -> None:
        """Print why the command ends without a result."""


class Display:
    """Show a run or a batch on a screen. `stop` may be called from a signal handler: the work ends with `Cancelled`."""

    def __init__(self, screen: Screen) -> None:
        self.screen, self.forecast = screen, Forecast()
        self._stop = threading.Event()
        self._states: dict[str, str] = {}

    def stop(self) -> None:
        """Ask the work to end."""
        self._stop.set()

    def check(self) -> None:
        """Raise `Cancelled` if the user asked to stop."""
        if self._stop.is_set():
            raise Cancelled

    def expect(self, parts: Sequence[Part]) -> None:
        """Take the parts that are to come, for what remains."""
        self.forecast.expect(parts)

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Show a stage while it lasts."""
        self.check()
        began, seconds = time.monotonic(), None
        counter = StageCounter(self, name)
        self.screen.begin(counter)
        try:
            yield counter
            seconds = time.monotonic() - began
        finally:
            self.screen.end(counter, seconds)
            self.forecast.end(name)

    def kept(self, name: str) -> None:
        """Show that a stage is up to date and not run again."""
        self.forecast.end(name)
        self.screen.kept(name)

    def warn(self, text: str) -> None:
        """Show a warning, one line."""
        self.screen.warn(text)

    def show(self, state: BatchState) -> None:
        """Show a batch; called a few times a second."""
        changed = [project for project in state.projects if self._states.get(project.name) != project.state]
        self._states |= {project.name: project.state for project in changed}
        self.screen.show(state, changed)


class StageCounter:
    """Count the units of a stage: the `Progress` of a display."""

    def __init__(self, display: Display, name: str) -> None:
        self.name, self.unit = name, ""
        self.done, self.total = 0, 1
        self._display = display
        self._lock = threading.Lock()

    def start(self, total: int, unit: str = "images") -> None:
        """Count from 0 to `total`. Raises `Cancelled` if the user asked to stop."""
        self.check()
        with self._lock:
            self.done, self.total, self.unit = 0, max(1, total), unit
            self._display.forecast.begin(self.name, unit)
            self._display.screen.move(self)

    def advance(self, count: int = 1) -> None:
        """Count more units. Raises `Cancelled` if the user asked to stop."""
        with self._lock:
            self.done = min(self.done + count, self.total)
            self._display.forecast.reach(self.done / self.total)
            self._display.screen.move(self)
        self.check()

    def check(self) -> None:
        """Raise `Cancelled` if the user asked to stop."""
        self._display.check()

    def left_s(self) -> tuple[float | None, float | None]:
        """Return the seconds that the stage still takes, and the whole run; None where they are not known yet."""
        forecast = self._display.forecast
        return forecast.remaining_s(self.name), forecast.remaining_s()
