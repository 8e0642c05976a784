"""What a person sees while we work: bars with the remaining time on stderr, tables on stdout."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

from colmap_ihe.commandline.display import Display, StageDisplay, printable
from colmap_ihe.report.summary import summary_rows

_PIPE_WIDTH = 400
_PLAIN_EVERY = 10
"""Percent between two lines where stderr is no terminal."""


class Bars(Display):
    """Follows a run on stderr. On a terminal with bars, else with a plain line now and then.

    `verbose` says how long each stage took; `quiet` leaves only warnings.
    """

    def __init__(self, *, quiet: bool = False, verbose: bool = False) -> None:
        super().__init__()
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)
        self.quiet, self.verbose = quiet, verbose

    def warn(self, text: str) -> None:
        self.say("warning", text, style="yellow", always=True)

    def result(self, text: str) -> None:
        print(text)

    def failed(self, message: str, hint: str) -> None:
        print(printable(f"colmap-ihe: {message}{f' ({hint})' if hint else ''}"), file=sys.stderr)

    def _piece(self, name: str) -> StageDisplay:
        return _Bar(self, name) if self.console.is_terminal and not self.quiet else _Plain(self, name)

    def _kept(self, name: str) -> None:
        self.say(name, "up to date")

    def say(self, name: str, text: str, style: str = "", *, always: bool = False) -> None:
        if always or not self.quiet:
            self.console.print(Text(printable(f"{name:>9}  {text}"), style=style))


class _Bar(StageDisplay):
    """On a terminal."""

    def __init__(self, bars: Bars, name: str) -> None:
        super().__init__(bars, name)
        self._bars = bars
        self._rich = Progress(
            TextColumn("{task.description:>9}"),
            BarColumn(bar_width=32),
            MofNCompleteColumn(),
            TextColumn("{task.fields[unit]}"),
            TimeElapsedColumn(),
            _Left(self),
            console=bars.console,
        )
        self._rich.start()
        self._task = self._rich.add_task(name, total=None, unit="")

    def _started(self) -> None:
        # One unit has no part to show: the bar moves to and fro until it is done.
        self._rich.reset(self._task, total=self.total if self.total > 1 else None, unit=self.unit)

    def _advanced(self) -> None:
        self._rich.update(self._task, completed=self.done)

    def over(self, seconds: float) -> None:
        total = max(1, self.total)
        self._rich.update(self._task, total=total, completed=total)
        self.done = total

    def close(self) -> None:
        self._rich.stop()


class _Left(ProgressColumn):
    """What remains of the stage, and of the whole run where that is more."""

    def __init__(self, piece: StageDisplay) -> None:
        super().__init__()
        self._piece = piece

    def render(self, task: Task) -> Text:
        return Text("" if task.finished else left_in_words(*self._piece.left_s()))


class _Plain(StageDisplay):
    """Where stderr is no terminal, or nothing is wanted."""

    def __init__(self, bars: Bars, name: str) -> None:
        super().__init__(bars, name)
        self._bars = bars
        self._told = 0
        bars.say(name, "...")

    def _started(self) -> None:
        self._told = 0

    def _advanced(self) -> None:
        percent = 100 * self.done // max(1, self.total)
        if percent < self._told + _PLAIN_EVERY and self.done != self.total:
            return
        self._told = percent - percent % _PLAIN_EVERY
        left = left_in_words(*self.left_s())
        self._bars.say(self.name, f"{self.done} of {self.total} {self.unit}{f', {left}' if left else ''}")

    def over(self, seconds: float) -> None:
        if self._bars.verbose:
            self._bars.say(self.name, f"took {seconds:.1f} s")

    def close(self) -> None:
        pass


def left_in_words(stage_s: float | None, run_s: float | None) -> str:
    """As "0:20 left, 4:10 in all"; empty where nothing is known."""
    if run_s is None:
        return ""
    if stage_s is None or run_s - stage_s < 1:
        return f"{_clock(run_s)} left"
    return f"{_clock(stage_s)} left, {_clock(run_s)} in all"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


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
        table.add_row(*(Text(printable(cell)) for cell in row))
    console.print(table)


def print_summary(summary: Mapping[str, Any], title: str) -> None:
    print_table(title, summary_rows(summary))
    for text in summary["warnings"]:
        Console(highlight=False, soft_wrap=True).print(Text(printable(f"warning: {text}")))
    for text in summary["left_out"].values():
        Console(highlight=False, soft_wrap=True).print(Text(printable(f"left out: {text}")))
    sys.stdout.flush()
