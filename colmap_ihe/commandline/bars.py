"""Print for a person: progress and warnings on stderr, tables on stdout."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rich import progress
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from colmap_ihe.batch.state import BatchState, ProjectState, facts_of
from colmap_ihe.commandline.display import StageCounter, failure_line, printable
from colmap_ihe.report.charts import duration
from colmap_ihe.report.tables import summary_rows

_PIPE_WIDTH = 400
_LINE_PERCENT = 10  # between two lines of a stage, where stderr is no terminal
_MOST_LINES = 12  # of running projects of a batch
_LINE_SECONDS = 60.0  # between two lines of a whole batch, where stderr is no terminal


class Terminal:
    """Print for a person, on stderr: bars with the remaining time on a terminal, else a line now and then. `verbose`
    adds how long each stage took; `quiet` leaves only warnings."""

    def __init__(self, *, quiet: bool = False, verbose: bool = False) -> None:
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._quiet, self._verbose = quiet, verbose
        self._has_bars = self.console.is_terminal and not quiet
        self._bar: progress.Progress | None = None
        self._batch: Live | None = None
        self._percent = 0
        self._next_line = time.monotonic() + _LINE_SECONDS

    def begin(self, stage: StageCounter) -> None:
        if not self._has_bars:
            self._say(stage.name, "...")
            return
        self._bar = progress.Progress(
            progress.TextColumn("{task.description:>9}"),
            progress.BarColumn(bar_width=32),
            _Units(),
            progress.TimeElapsedColumn(),
            _RemainingTime(stage),
            console=self.console,
        )
        self._bar.start()
        self._bar.add_task(stage.name, total=None, unit="")

    def move(self, stage: StageCounter) -> None:
        if self._bar is not None and stage.done:
            self._bar.update(self._bar.task_ids[0], completed=stage.done)
        elif self._bar is not None:
            # One unit has no part to show: the bar moves to and fro until it is done.
            total = stage.total if stage.total > 1 else None
            self._bar.reset(self._bar.task_ids[0], total=total, unit=stage.unit)
        else:
            self._print_tenth(stage)

    def _print_tenth(self, stage: StageCounter) -> None:
        if stage.total == 1:  # the stage itself has a line already
            return
        percent = 100 * stage.done // stage.total
        if not stage.done:
            self._percent = 0
        elif percent >= self._percent + _LINE_PERCENT or stage.done == stage.total:
            self._percent = percent - percent % _LINE_PERCENT
            left = left_in_words(*stage.left_s())
            self._say(stage.name, f"{stage.done} of {stage.total} {stage.unit}{f', {left}' if left else ''}")

    def end(self, stage: StageCounter, seconds: float | None) -> None:
        if self._bar is not None:
            if seconds is not None:
                self._bar.update(self._bar.task_ids[0], total=stage.total, completed=stage.total)
            self._bar.stop()
            self._bar = None
        elif seconds is not None and self._verbose:
            self._say(stage.name, f"took {seconds:.1f} s")

    def kept(self, name: str) -> None:
        self._say(name, "up to date")

    def warn(self, text: str) -> None:
        self._print("warning", text, "yellow")

    def show(self, state: BatchState, changed: Sequence[ProjectState]) -> None:
        for project in changed:
            if project.kind == "failed":
                self._print(project.name, outcome_in_words(project), "red")
            elif project.state not in ("waiting", "running"):
                self._say(project.name, outcome_in_words(project))
            elif project.state == "running" and not self._has_bars:
                self._say(project.name, "begun")
        if self._has_bars:
            self._picture(state)
        elif time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + _LINE_SECONDS
            self._say("batch", state.in_words())

    def _picture(self, state: BatchState) -> None:
        if self._batch is None:
            self._batch = Live(console=self.console, refresh_per_second=4, transient=True)
            self._batch.start()
        self._batch.update(batch_picture(state))
        if state.phase in ("finished", "stopped"):
            self._batch.stop()

    def result(self, text: str) -> None:
        print(text)

    def failed(self, message: str, hint: str) -> None:
        print(failure_line(message, hint), file=sys.stderr)

    def _say(self, name: str, text: str) -> None:
        if not self._quiet:
            self._print(name, text)

    def _print(self, name: str, text: str, style: str = "") -> None:
        self.console.print(Text(printable(f"{name:>9}  {text}"), style=style))


class _Units(progress.ProgressColumn):
    """Show how many units are done, as "5/11 images"; nothing where the only one is the work itself."""

    def render(self, task: progress.Task) -> Text:
        unit = task.fields["unit"]
        if task.total is None or task.total <= 1:
            return Text(unit if task.total is None else "")
        return Text(f"{int(task.completed)}/{int(task.total)} {unit}", style="progress.download")


class _RemainingTime(progress.ProgressColumn):
    """Show what remains of the stage, and of the whole run where that is more."""

    def __init__(self, stage: StageCounter) -> None:
        super().__init__()
        self._stage = stage

    def render(self, task: progress.Task) -> Text:
        return Text("" if task.finished else left_in_words(*self._stage.left_s()))


def left_in_words(stage_s: float | None, run_s: float | None) -> str:
    """Return what remains as "0:20 left, 4:10 in all"; empty where nothing is known."""
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
    """Print a table on stdout; lines of words where stdout is no terminal, so that it can be piped."""
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
    """Print the summary of a project, its warnings, and the photographs that are left out, on stdout."""
    print_table(title, summary_rows(summary))
    lines = [f"warning: {text}" for text in summary["warnings"]]
    lines += [f"left out: {text}" for text in summary["left_out"].values()]
    for line in lines:
        Console(highlight=False, soft_wrap=True).print(Text(printable(line)))
    sys.stdout.flush()


def print_batch(state: BatchState) -> None:
    """Print how each project of a batch ended, on stdout."""
    rows = []
    for project in state.projects:
        figures = project.figures
        registered, error = figures.get("registered_images"), figures.get("mean_reprojection_error_px")
        row = [
            project.name,
            project.in_words,
            "" if registered is None else f"{registered} of {figures['images']}",
            "" if error is None else f"{error:.2f} px",
            duration(sum(project.stages.values())) if project.stages else "",
            project.reason,
        ]
        rows.append(row)
    if rows:
        print_table("", rows, ("project", "state", "registered images", "mean error", "time", "why"))
    print(state.in_words())


def outcome_in_words(project: ProjectState) -> str:
    """Return the state of a project with its reason, or with its figures if it is done."""
    if project.reason:
        return f"{project.in_words}: {project.reason}" + (f" ({project.hint})" if project.hint else "")
    facts = ", ".join(f"{name} {value}" for name, value in facts_of(project))
    return f"{project.in_words}: {facts}" if project.state == "done" and facts else project.in_words


def batch_picture(state: BatchState) -> Group:
    """Return a line for each project that runs, and a bar for all projects."""
    rows = Table.grid(padding=(0, 2))
    running = [project for project in state.projects if project.state == "running"]
    for project in running[:_MOST_LINES]:
        done, total = project.progress or (0, 0)
        units = f"{done} of {total}" if total > 1 else ""
        rows.add_row(Text(printable(project.name)), Text(project.stage or "starts"), Text(units))
    if len(running) > _MOST_LINES:
        rows.add_row(Text(f"and {len(running) - _MOST_LINES} more"))
    whole = Table.grid(padding=(0, 2))
    bar = ProgressBar(total=max(1, len(state.projects)), completed=state.ended, width=32)
    whole.add_row(bar, Text(state.in_words()))
    return Group(rows, whole)
