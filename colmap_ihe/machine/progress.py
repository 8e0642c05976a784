"""How long work reports to whoever watches, and learns that it should stop.

Every room may import this module. What is shown, and where, is decided by the caller: the command line
passes bars on stderr, a test passes `SILENT`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.remaining_time import Part


class Progress(Protocol):
    """One piece of long work, watched."""

    def start(self, total: int, unit: str = "images") -> None:
        """The work has `total` units; called before the first `advance`, and again for a next part."""

    def advance(self, count: int = 1) -> None:
        """`count` more units are done. Raises `Cancelled` if the user asked to stop."""

    def check(self) -> None:
        """Raises `Cancelled` if the user asked to stop."""


class RunProgress(Protocol):
    """Whoever follows a whole run, stage by stage."""

    def expect(self, parts: Sequence[Part]) -> None:
        """What is to come, in order, and what it costs elsewhere: from it follows what remains."""

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        """`name` begins; what is returned watches it and is left when it ends."""

    def kept(self, name: str) -> None:
        """`name` is up to date and not run again."""

    def warn(self, text: str) -> None:
        """Something the user should know, in one line."""


class Silent:
    """Watches nothing, and shows nothing; stops when `cancelled` is set."""

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
