"""What every follower of a run has in common: it can stop it, counts what is done, and knows what remains."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Forecast, Part


def printable(text: str) -> str:
    """Text for a terminal: what a photograph or a file says of itself may hold characters that would steer it."""
    return "".join(
        c if c.isprintable() else " " if c in "\t\n\r" else c.encode("unicode_escape").decode() for c in text
    )


class Display(ABC):
    """Show a run. `stop` may be called from a signal handler: the work under way then ends with `Cancelled`."""

    def __init__(self) -> None:
        self.forecast = Forecast()
        self._stop = threading.Event()

    def stop(self) -> None:
        self._stop.set()

    def check(self) -> None:
        if self._stop.is_set():
            raise Cancelled

    def expect(self, parts: Sequence[Part]) -> None:
        self.forecast.expect(parts)

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        self.check()
        began = time.monotonic()
        piece = self._piece(name)
        try:
            yield piece
            piece.over(time.monotonic() - began)
        finally:
            piece.close()
            self.forecast.end(name)

    def kept(self, name: str) -> None:
        self.forecast.end(name)
        self._kept(name)

    @abstractmethod
    def warn(self, text: str) -> None:
        """Something the user should know, in one line."""

    @abstractmethod
    def result(self, text: str) -> None:
        """The result as JSON text."""

    @abstractmethod
    def failed(self, message: str, hint: str) -> None:
        """The command ends without a result."""

    @abstractmethod
    def _piece(self, name: str) -> StageDisplay: ...

    @abstractmethod
    def _kept(self, name: str) -> None: ...


class StageDisplay(ABC):
    """A `Progress` that counts. What it shows is up to `_started`, `_advanced`, `over` and `close`."""

    def __init__(self, follower: Display, name: str) -> None:
        self.name, self.unit = name, ""
        self.done, self.total = 0, 0
        self._follower = follower
        self._lock = threading.Lock()

    def start(self, total: int, unit: str = "images") -> None:
        self._follower.check()
        with self._lock:
            self.done, self.total, self.unit = 0, max(1, total), unit
            self._follower.forecast.begin(self.name, unit)
            self._started()

    def advance(self, count: int = 1) -> None:
        with self._lock:
            self.done = min(self.done + count, max(1, self.total))
            self._follower.forecast.reach(self.done / max(1, self.total))
            self._advanced()
        self._follower.check()

    def check(self) -> None:
        self._follower.check()

    def left_s(self) -> tuple[float | None, float | None]:
        """Seconds that the stage still takes, and the whole run; None where they are not known yet."""
        forecast = self._follower.forecast
        return forecast.remaining_s(self.name), forecast.remaining_s()

    @abstractmethod
    def _started(self) -> None: ...

    @abstractmethod
    def _advanced(self) -> None: ...

    @abstractmethod
    def over(self, seconds: float) -> None:
        """The stage came to its end."""

    @abstractmethod
    def close(self) -> None:
        """The stage ended, or broke off."""
