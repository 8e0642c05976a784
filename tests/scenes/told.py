"""Note what a person would be shown."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from colmap_ihe.machine.progress import Silent


class Told(Silent):
    """Keep the stages that began, those that were up to date, and the warnings."""

    def __init__(self) -> None:
        super().__init__()
        self.begun: list[str] = []
        self.up_to_date: list[str] = []
        self.warnings: list[str] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[Silent]:
        self.begun.append(name)
        yield self

    def kept(self, name: str) -> None:
        self.up_to_date.append(name)

    def warn(self, text: str) -> None:
        self.warnings.append(text)
