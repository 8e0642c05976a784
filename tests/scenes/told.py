"""Note what a run tells its user."""

from __future__ import annotations

from colmap_ihe.machine.progress import Silent


class Told(Silent):
    """Keep the warnings, and the names of what is up to date."""

    def __init__(self) -> None:
        super().__init__()
        self.warnings: list[str] = []
        self.up_to_date: list[str] = []

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def kept(self, name: str) -> None:
        self.up_to_date.append(name)
