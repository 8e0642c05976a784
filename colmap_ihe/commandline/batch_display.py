"""A batch on stderr: on a terminal a line for each project that runs and a bar for all, else a line for each change."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from types import TracebackType

from rich.console import Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from colmap_ihe.batch.state import BatchState, ProjectState, facts_of
from colmap_ihe.commandline.bars import Bars, print_table
from colmap_ihe.commandline.display import Display, printable
from colmap_ihe.commandline.json_lines import JsonLines
from colmap_ihe.report.charts import duration

_PLAIN_SECONDS = 60.0
"""Between two lines on the whole, where stderr is no terminal."""
_LINES_SECONDS = 10.0
_SHOWN = 12  # lines of running projects


def batch_audience(follower: Display) -> AbstractContextManager[BatchBars | BatchLines]:
    """What shows a batch as `follower` shows a run."""
    if isinstance(follower, JsonLines):
        return nullcontext(BatchLines(follower))
    if isinstance(follower, Bars):
        return BatchBars(follower)
    raise TypeError(f"{type(follower).__name__}, expected Bars or JsonLines")


class BatchLines:
    """Follows a batch as lines of JSON: `project` where one changes its state, `batch` once in ten seconds."""

    def __init__(self, lines: JsonLines) -> None:
        self._lines = lines
        self._states: dict[str, str] = {}
        self._next = 0.0

    def check(self) -> None:
        self._lines.check()

    def warn(self, text: str) -> None:
        self._lines.warn(text)

    def show(self, state: BatchState) -> None:
        for project in state.projects:
            if self._states.get(project.name) != project.state:
                self._states[project.name] = project.state
                why = {"reason": project.reason, "hint": project.hint}
                self._lines.say("project", project=project.name, state=project.state, **why)
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + _LINES_SECONDS
            ended = sum(project.kind in ("done", "failed") for project in state.projects)
            left = None if state.remaining_s is None else round(state.remaining_s, 1)
            self._lines.say("batch", ended=ended, projects=len(state.projects), seconds_left=left)


class BatchBars:
    """Follows a batch, by the console and the stop of `bars`."""

    def __init__(self, bars: Bars) -> None:
        self._bars, self._live = (
            bars,
            None
            if bars.quiet or not bars.console.is_terminal
            else Live(console=bars.console, refresh_per_second=4, transient=True),
        )
        self._states: dict[str, str] = {}
        self._next = time.monotonic() + _PLAIN_SECONDS

    def __enter__(self) -> BatchBars:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def check(self) -> None:
        self._bars.check()

    def warn(self, text: str) -> None:
        self._bars.warn(text)

    def show(self, state: BatchState) -> None:
        for project in state.projects:
            if self._states.get(project.name) != project.state:
                self._states[project.name] = project.state
                self._changed(project)
        if self._live is not None:
            self._live.update(_picture(state))
        elif not self._bars.quiet and time.monotonic() >= self._next:
            self._next = time.monotonic() + _PLAIN_SECONDS
            self._say(f"{'batch':>9}  {state.in_words()}")

    def _changed(self, project: ProjectState) -> None:
        line = f"{project.name:>9}  {_line(project)}"
        if project.kind == "failed":
            self._bars.console.print(Text(printable(line), style="red"))
        elif not self._bars.quiet and project.state not in ("waiting", "running"):
            self._say(line)
        elif self._live is None and project.state == "running":
            self._say(f"{project.name:>9}  begun")

    def _say(self, text: str) -> None:
        if not self._bars.quiet:
            self._bars.console.print(Text(printable(text)))


def _line(project: ProjectState) -> str:
    if project.reason:
        return f"{project.in_words}: {project.reason}" + (f" ({project.hint})" if project.hint else "")
    facts = ", ".join(f"{name} {value}" for name, value in facts_of(project))
    return f"{project.in_words}: {facts}" if project.state == "done" and facts else project.in_words


def _picture(state: BatchState) -> Group:
    rows = Table.grid(padding=(0, 2))
    running = [project for project in state.projects if project.state == "running"]
    for project in running[:_SHOWN]:
        done, total = project.progress or (0, 0)
        part = f"{done} of {total}" if total > 1 else ""
        rows.add_row(Text(printable(project.name)), Text(project.stage or "starts"), Text(part))
    if len(running) > _SHOWN:
        rows.add_row(Text(f"and {len(running) - _SHOWN} more"))
    ended = sum(project.kind in ("done", "failed") for project in state.projects)
    whole = Table.grid(padding=(0, 2))
    bar = ProgressBar(total=max(1, len(state.projects)), completed=ended, width=32)
    whole.add_row(bar, Text(state.in_words()))
    return Group(rows, whole)


def print_batch(state: BatchState) -> None:
    """What all have come to, on stdout."""
    rows = []
    for project in state.projects:
        of = project.figures
        registered = (
            "" if of.get("registered_images") is None else f"{of['registered_images']} of {of['images']}"
        )
        error = of.get("mean_reprojection_error_px")
        time_taken = duration(sum(project.stages.values())) if project.stages else ""
        error_px = "" if error is None else f"{error:.2f} px"
        rows.append((project.name, project.in_words, registered, error_px, time_taken, project.reason))
    if rows:
        columns = ("project", "state", "registered images", "mean error", "time", "why")
        print_table("", rows, columns)
    print(f"{state.in_words()}")
