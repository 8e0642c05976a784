"""Run every project below a folder, each in a process of its own, as many at a time as memory has room for.

What is known of a project is on the disk and nowhere else: a batch may end at any moment, and the same command goes on.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from colmap_ihe.batch.entry import Entry, remaining_of, share_of
from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.batch.preview import preview_project
from colmap_ihe.batch.state import BatchState, Phase, State, publish, time_of
from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.errors import BusyError, KnownError
from colmap_ihe.machine import memory
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline.job import GOES_ON, GRACE_SECONDS, Outcome, ProjectJob, StageProgress, run_job
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import load_options

_TICK_SECONDS = 0.25
_PUBLISH_SECONDS = 5.0
_SCAN_SECONDS = 5.0
_BUSY_SECONDS = 5.0  # until the next try at a project that another run works on
_BUSY_TRIES = 5  # a run that a killed batch left behind ends within that time
_ROOM = 0.9  # of the memory that is available
_USUAL = (20.0, 12.0)
"""Megapixels, and core seconds for each, that count as done before anything is. Rough; see docs/batch.md."""


class BatchDisplay(Protocol):
    """Show a batch to a person or a program."""

    def check(self) -> None:
        """Raise `Cancelled` if the user asked to stop."""

    def warn(self, text: str) -> None:
        """Show a warning, one line."""

    def show(self, state: BatchState) -> None:
        """Show the state of all projects; called a few times a second."""


def batch(
    root: str | Path,
    *,
    assignments: Sequence[str] = (),
    jobs: int | None = None,
    time_limit_s: float | None = None,
    watch: bool = False,
    settle_s: float = 30.0,
    progress: BatchDisplay,
    executor: Executor | None = None,
    command: str = "",
) -> BatchState:
    """Run what is missing of every project below `root`, and return how all ended.

    At most `jobs` at a time, of as many as memory has room for; if None, one a core, or one with a GPU. `executor`
    runs whole projects elsewhere, where they find the same folders: then memory is its own affair, and None hands
    over all at once. `watch` goes on with projects that appear, once their files were not touched for `settle_s`,
    until `Cancelled`. `command` is shown as what goes on with the batch. Raises `OptionError` for bad assignments,
    `ProjectError` for a root that is none, `Cancelled`.
    """
    load_options(None, assignments)
    folder = BatchFolder.at(Path(root))
    folder.make()
    at_once = 1 if pick_backend("auto") == "patchmatch" else local_workers()  # there is one GPU
    with ExitStack() as stack:

        def pool(workers: int, name: str) -> Executor:
            threads = ThreadPoolExecutor(workers, thread_name_prefix=name)
            stack.callback(threads.shutdown, wait=False, cancel_futures=True)
            return threads

        run = _Batch(
            folder=folder,
            assignments=tuple(assignments),
            display=progress,
            previewer=pool(1, "preview"),
            runner=executor or pool(jobs or at_once, "project"),
            most=jobs or (math.inf if executor else at_once),
            elsewhere=executor is not None,
            time_limit_s=time_limit_s,
            settle_s=settle_s if watch else None,
            command=command,
            stop_file=folder.stop_file(),
        )
        stack.callback(run.end)
        return run.until_done()


@dataclass
class _Batch:
    """Run the projects of a folder. `settle_s` is None unless it watches the folder for more."""

    folder: BatchFolder
    assignments: tuple[str, ...]
    display: BatchDisplay
    previewer: Executor
    runner: Executor
    most: float
    elsewhere: bool
    time_limit_s: float | None
    settle_s: float | None
    command: str
    stop_file: Path
    began: float = field(default_factory=time.time)
    entries: dict[Path, Entry] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    phase: Phase = "running"
    done_megapixels: float = _USUAL[0]
    done_seconds: float = field(default_factory=lambda: _USUAL[0] * _USUAL[1] / local_workers())
    _next_scan: float = 0.0
    _next_page: float = 0.0
    _published: Sequence[tuple[str, str]] = ()

    def until_done(self) -> BatchState:
        """Run until all projects have ended; where it watches, until `Cancelled`."""
        if self.settle_s is not None:
            self.phase = "watching"
        self._scan()
        if not self.entries and self.settle_s is None:
            self._warn(f"{self.folder.root}: no project found; one is a folder with photographs in images/")
        while True:
            self._collect()
            self._start()
            states = {entry.state for entry in self.entries.values()}
            if self.settle_s is None and not states & {"waiting", "running"}:
                break
            self._publish(_PUBLISH_SECONDS)
            self.display.check()
            self._wait()
            if self.settle_s is not None and time.monotonic() >= self._next_scan:
                self._scan()
        self.phase = "finished"
        self._publish()
        return self._state()

    def end(self) -> None:
        """Stop what still runs, and leave the page as things stand then."""
        if self.phase == "finished":
            return
        running = [entry.running for entry in self._running() if entry.running is not None]
        if running:
            with suppress(OSError):
                self.stop_file.touch()
        for future in running:
            future.cancel()
        try:
            wait(running, GRACE_SECONDS + 15)
        finally:
            self._collect()
            self.phase = "stopped"
            self._publish()
            self.stop_file.unlink(missing_ok=True)

    def _running(self) -> list[Entry]:
        return [entry for entry in self.entries.values() if entry.running is not None]

    def _wait(self) -> None:
        futures: list[Future[Any]] = []
        for entry in self.entries.values():
            futures += [future for future in (entry.previewing, entry.running) if future]
        if futures:
            wait(futures, _TICK_SECONDS, return_when=FIRST_COMPLETED)
        else:
            time.sleep(_TICK_SECONDS)

    def _scan(self) -> None:
        """Take up new projects and changed ones, and drop those that are gone."""
        roots = self.folder.projects(self._warn)
        first: State = "waiting" if self.settle_s is None else "copying"
        for root in roots:
            entry = self.entries.setdefault(root, Entry(root, first))
            if self.settle_s is not None:
                entry.settle(self.settle_s)
        for root in self.entries.keys() - set(roots):
            if self.entries[root].running is None:
                del self.entries[root]
        self._next_scan = time.monotonic() + _SCAN_SECONDS

    def _collect(self) -> None:
        """Take the previews and runs that have ended."""
        for entry in self.entries.values():
            if entry.previewing is not None and entry.previewing.done():
                entry.preview, entry.previewing = entry.previewing.result(), None
                if entry.preview.up_to_date:
                    entry.to("done")
                elif entry.preview.reason:
                    self._fail(entry, entry.preview.reason, entry.preview.hint)
            if entry.running is not None and entry.running.done():
                outcome, entry.running = _outcome_of(entry.running), None
                self._take(entry, outcome)

    def _fail(self, entry: Entry, reason: str, hint: str) -> None:
        entry.end(Outcome("failed", 0.0, reason=reason, hint=hint), self.assignments)

    def _take(self, entry: Entry, outcome: Outcome) -> None:
        """Take the outcome of a run, or let it run again."""
        if outcome.state == "busy":
            self._skip(entry, outcome.reason, outcome.hint)
        elif outcome.state == "out_of_memory" and self._running() and not self.elsewhere:
            entry.alone = True
            entry.to("waiting", "memory ran out beside other projects: it runs again by itself")
        else:
            entry.end(outcome, self.assignments)
        if outcome.state == "done":
            self.done_megapixels += entry.megapixels
            self.done_seconds += outcome.seconds
        if entry.changed:
            entry.begin_anew("copying")

    def _skip(self, entry: Entry, reason: str, hint: str) -> None:
        """Try a project on which another run works later, and leave it to that run in the end."""
        entry.tries += 1
        if entry.tries <= _BUSY_TRIES or self.settle_s is not None:
            entry.begin_anew("waiting", reason, wait_s=_BUSY_SECONDS)
        else:
            entry.to("busy", reason, hint)

    def _start(self) -> None:
        """Start previews, and as many runs as there is room for."""
        for entry in self.entries.values():
            running = self._running()
            if entry.may_begin and entry.preview is None:
                entry.previewing = entry.previewing or self.previewer.submit(
                    preview_project, entry.root, self.assignments
                )
            elif entry.may_begin and len(running) < self.most:
                room = int(memory.available() * _ROOM)
                share = 0 if self.elsewhere else share_of(entry, running, room)
                if share is not None:
                    self._launch(entry, share)

    def _launch(self, entry: Entry, share: int) -> None:
        try:
            with Project.at(entry.root).locked():
                pass
        except KnownError as error:
            decline = self._skip if isinstance(error, BusyError) else self._fail
            decline(entry, str(error), error.hint)
            return
        job = ProjectJob(str(entry.root), self.assignments, self.time_limit_s, share, str(self.stop_file))
        entry.to("running")
        entry.progress, entry.began, entry.began_s = StageProgress(), time.time(), time.monotonic()
        follow = () if self.elsewhere else (entry.follow,)
        entry.running = self.runner.submit(run_job, job, *follow)

    def _state(self) -> BatchState:
        shown = [entry.shown(self.folder, self.phase == "stopped") for entry in self.entries.values()]
        return BatchState(
            root=str(self.folder.root),
            phase=self.phase,
            projects=sorted(shown, key=lambda project: project.name),
            began=time_of(self.began),
            remaining_s=remaining_of(list(self.entries.values()), self.done_seconds / self.done_megapixels),
            command=self.command,
            warnings=tuple(self.warnings),
        )

    def _publish(self, every: float = 0.0) -> None:
        """Show the batch, and write the page where a state changed or it is older than `every` seconds."""
        state = self._state()
        self.display.show(state)
        states = [(project.name, project.state) for project in state.projects]
        if every and states == self._published and time.monotonic() < self._next_page:
            return
        self._published, self._next_page = states, time.monotonic() + every
        previews = {self.folder.name_of(root): entry.preview for root, entry in self.entries.items()}
        thumbnails = {name: p.thumbnail for name, p in previews.items() if p and p.thumbnail}
        try:
            publish(self.folder, state, thumbnails)
        except KnownError as error:
            self._warn(f"the page of the batch could not be written: {error}")

    def _warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)
            self.display.warn(text)


def _outcome_of(future: Future[Outcome]) -> Outcome:
    """Return how a run ended, also if it was lost."""
    if future.cancelled():
        return Outcome("stopped", 0.0, reason="stopped before it began", hint=GOES_ON)
    try:
        return future.result()
    except Exception as error:  # noqa: BLE001  an executor that lost a worker, say
        lost = f"its run was lost: {type(error).__name__}: {error}"
        return Outcome("crashed", 0.0, reason=lost, hint=GOES_ON)
