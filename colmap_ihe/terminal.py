"""What a person sees while we work: bars with the remaining time on stderr, tables on stdout."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from colmap_ihe.errors import Cancelled
from colmap_ihe.progress import Watch
from colmap_ihe.report.summary import summary_rows

_PIPE_WIDTH = 400
_PLAIN_EVERY = 10
"""Percent between two lines where stderr is no terminal."""


class Bars:
    """Follows a run on stderr. On a terminal with bars, else with a plain line now and then.

    `stop` may be called from a signal handler: what is being watched then ends with `Cancelled`.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)
        self.quiet = quiet
        self._stop = threading.Event()

    def stop(self) -> None:
        self._stop.set()

    def check(self) -> None:
        if self._stop.is_set():
            raise Cancelled

    @contextmanager
    def stage(self, name: str) -> Iterator[Watch]:
        self.check()
        with _Bar(self, name) as bar:
            yield bar

    def kept(self, name: str) -> None:
        self._say(f"{name:>9}  up to date")

    def warn(self, text: str) -> None:
        self._say(f"{'warning':>9}  {text}", style="yellow", always=True)

    def _say(self, text: str, style: str = "", *, always: bool = False) -> None:
        if always or not self.quiet:
            self.console.print(Text(text, style=style))


class _Bar:
    def __init__(self, bars: Bars, name: str) -> None:
        self._bars, self._name = bars, name
        self._done = self._total = self._told = 0
        self._unit = ""
        self._rich: Progress | None = None
        self._task: Any = None
        self._lock = threading.Lock()

    def __enter__(self) -> _Bar:
        if self._bars.console.is_terminal and not self._bars.quiet:
            self._rich = Progress(
                TextColumn("{task.description:>9}"),
                BarColumn(bar_width=32),
                MofNCompleteColumn(),
                TextColumn("{task.fields[unit]}"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=self._bars.console,
            )
            self._rich.start()
            self._task = self._rich.add_task(self._name, total=None, unit="")
        else:
            self._bars._say(f"{self._name:>9}  ...")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._rich is not None:
            if kind is None:
                total = max(1, self._total)
                self._rich.update(self._task, total=total, completed=total)
            self._rich.stop()

    def start(self, total: int, unit: str = "images") -> None:
        self._bars.check()
        with self._lock:
            self._done, self._total, self._unit, self._told = 0, max(1, total), unit, 0
            if self._rich is not None:
                # One unit has no part to show: the bar moves to and fro until it is done.
                self._rich.reset(self._task, total=self._total if total > 1 else None, unit=unit)

    def advance(self, count: int = 1) -> None:
        with self._lock:
            self._done += count
            if self._rich is not None:
                self._rich.update(self._task, completed=min(self._done, self._total))
            else:
                self._tell()
        self._bars.check()

    def check(self) -> None:
        self._bars.check()

    def _tell(self) -> None:
        percent = min(100, 100 * self._done // self._total)
        if percent >= self._told + _PLAIN_EVERY or self._done == self._total:
            self._told = percent - percent % _PLAIN_EVERY
            self._bars._say(f"{self._name:>9}  {min(self._done, self._total)} of {self._total} {self._unit}")


def print_table(title: str, rows: Sequence[Sequence[str]], columns: Sequence[str] = ()) -> None:
    """A table on stdout: lines of words where stdout is no terminal, so that it can be piped."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    table = Table(
        title=title or None, title_justify="left", box=None, show_header=bool(columns), pad_edge=False
    )
    for number in range(max(len(row) for row in rows)):
        table.add_column(columns[number] if columns else "", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)


def print_summary(summary: Mapping[str, Any], title: str) -> None:
    print_table(title, summary_rows(summary))
    for text in summary["warnings"]:
        Console(highlight=False, soft_wrap=True).print(Text(f"warning: {text}"))
    for text in summary["left_out"].values():
        Console(highlight=False, soft_wrap=True).print(Text(f"left out: {text}"))
    sys.stdout.flush()
