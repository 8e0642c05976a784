"""How long work reports to whoever watches, and learns that it should stop.

Every room may import this module. What is shown, and where, is decided by the caller: the
command line passes a bar on stderr, a test passes `SILENT`.
"""

from __future__ import annotations

from typing import Protocol

from colmap_ihe.errors import Cancelled


class Watch(Protocol):
    """One piece of long work, watched."""

    def start(self, total: int, unit: str = "images") -> None:
        """The work has `total` units; called once, before the first `advance`."""

    def advance(self, count: int = 1) -> None:
        """`count` more units are done. Raises `Cancelled` if the user asked to stop."""

    def check(self) -> None:
        """Raises `Cancelled` if the user asked to stop."""


class Silent:
    """Watches nothing; stops when `cancelled` is set."""

    def __init__(self) -> None:
        self.cancelled = False

    def start(self, total: int, unit: str = "images") -> None:
        self.check()

    def advance(self, count: int = 1) -> None:
        self.check()

    def check(self) -> None:
        if self.cancelled:
            raise Cancelled


SILENT: Watch = Silent()
