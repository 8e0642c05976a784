"""Stop work in the middle."""

from __future__ import annotations

from collections.abc import Callable

from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.progress import Silent


class StopsWhen(Silent):
    """Cancels once a condition holds, told how many units are done."""

    def __init__(self, condition: Callable[[int], object]) -> None:
        super().__init__()
        self.condition, self.done, self.total = condition, 0, 0

    def start(self, total: int, unit: str = "images") -> None:
        self.total = total

    def advance(self, count: int = 1) -> None:
        self.done += count
        self.check()

    def check(self) -> None:
        if self.condition(self.done):
            raise Cancelled
