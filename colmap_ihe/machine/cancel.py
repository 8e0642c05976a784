"""Cancelling of work: a thread learns that its work is no longer needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


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
