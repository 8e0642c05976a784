"""Report the progress of long work, and learn that it should stop.

Every room may import this module. The caller decides what is shown, and where: the command line passes a `Display`, a
test passes `SILENT`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Protocol

from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.remaining_time import Part


class Progress(Protocol):
    """Report one piece of long work."""

    def start(self, total: int, unit: str = "images") -> None:
        """Begin work of `total` units; called before the first `advance`, and again for a next part."""

    def advance(self, count: int = 1) -> None:
        """Report `count` more units done. Raises `Cancelled` if the user asked to stop."""

    def check(self) -> None:
        """Raise `Cancelled` if the user asked to stop."""


class RunProgress(Protocol):
    """Report a whole run, stage by stage."""

    def expect(self, parts: Sequence[Part]) -> None:
        """Expect these parts, in order; what remains follows from their costs."""

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        """Return the progress of a stage that begins, as a context that is left when it ends."""

    def kept(self, name: str) -> None:
        """Report that a stage is up to date and not run again."""

    def warn(self, text: str) -> None:
        """Tell the user something in one line."""


class Silent:
    """Show nothing; stop the work when `cancelled` is set."""

    def __init__(self) -> None:
        self.cancelled = False

    def start(self, total: int, unit: str = "images") -> None:
        self.check()

    def advance(self, count: int = 1) -> None:
        self.check()

    def check(self) -> None:
        if self.cancelled:
            raise Cancelled

    def expect(self, parts: Sequence[Part]) -> None:
        pass

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        return nullcontext(self)

    def kept(self, name: str) -> None:
        pass

    def warn(self, text: str) -> None:
        pass


SILENT = Silent()


class StopEvent(Protocol):
    """Tell that work is no longer needed: an Event, or what a task on another machine looks at."""

    def is_set(self) -> bool: ...


_stop: ContextVar[StopEvent | None] = ContextVar("stop", default=None)


@contextmanager
def stoppable(stop: StopEvent) -> Iterator[None]:
    """Within, end the reads of this thread with `Cancelled` soon after `stop` is set, however slow the decoder is."""
    token = _stop.set(stop)
    try:
        yield
    finally:
        _stop.reset(token)


def stopped() -> bool:
    """Tell whether what this thread works on, within `stoppable`, is no longer needed."""
    event = _stop.get()
    return event is not None and event.is_set()
