"""Every project below a folder, each run in a process of its own, as many at a time as memory has room for.

What a project has come to is on the disk and nowhere else, so that a batch may end at any moment and the same command
goes on, and two of them may work in one folder: who runs a project holds its lock.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Protocol

from colmap_ihe.batch.entry import Entry, look_of, outcome_of, remaining_of, share_of
from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.batch.preview import ProjectPreview, look_at
from colmap_ihe.batch.state import BatchState, Phase, publish, time_of
from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.errors import KnownError
from colmap_ihe.machine import memory
from colmap_ihe.machine.files import file_stamp
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline.job import GRACE_SECONDS, Outcome, ProjectJob, StageProgress, run_job
from colmap_ihe.project.options_file import load_options

_TICK_SECONDS = 0.25
_PUBLISH_SECONDS = 5.0
_AGAIN_SECONDS = 5.0  # until another look at a project that another run works on
_BUSY_TRIES = 5  # at one that no batch has: what a killed batch left behind ends within that time
_SCAN_SECONDS = 5.0
_ROOM = 0.9  # of the memory that is available
_USUAL = (20.0, 12.0)
"""Megapixels, and core seconds for each, that count as done before anything is. Rough; see docs/batch.md."""


class BatchAudience(Protocol):
    """Whoever follows a batch."""

    def check(self) -> None:
        """Raises `Cancelled` if the user asked to stop."""

    def warn(self, text: str) -> None:
        """Something the user should know, in one line."""

    def show(self, state: BatchState) -> None:
        """Where all of it stands; called a few times a second."""


def batch(
    root: str | Path,
    *,
    assignments: Sequence[str] = (),
    jobs: int | None = None,
    time_limit_s: float | None = None,
    watch: bool = False,
    settle_s: float = 30.0,
    progress: BatchAudience,
    executor: Executor | None = None,
    command: str = "",
) -> BatchState:
    """Runs what is missing of every project below `root`, and returns what all have come to.

    At most `jobs` at a time, of as many as memory has room for; if None, one a core, or one with a GPU. `executor`
    runs whole projects elsewhere, where they find the same folders: then memory is its own affair, and None hands
    over all at once. `watch` goes on with projects that appear, once their files were not touched for `settle_s`,
    until `Cancelled`. `command` is shown as what goes on with the batch. Raises `OptionError` for bad assignments,
    `ProjectError` for a root that is none, `Cancelled`.
    """
    load_options(None, assignments)
    folder = BatchFolder.at(Path(root))
    folder.make()
    with ExitStack() as stack:
        at_once = 1 if pick_backend("auto") == "patchmatch" else local_workers()  # there is one GPU
        most = jobs or (None if executor else at_once)
        looker = ThreadPoolExecutor(1, thread_name_prefix="look")
        runner = executor or ThreadPoolExecutor(most, thread_name_prefix="project")
        for pool in (looker, *([] if executor else [runner])):
            stack.callback(pool.shutdown, wait=False, cancel_futures=True)
        run = _Batch(folder, tuple(assignments), looker, runner, progress)
        run.most, run.elsewhere, run.time_limit_s, run.command = (
            most,
            executor is not None,
            time_limit_s,
            command,
        )
        run.settle_s = settle_s if watch else None
        stack.callback(run.end)
        return run.until_done()


class _Batch:
    most: int | None = None
    elsewhere = False
    time_limit_s: float | None = None
    settle_s: float | None = None
    command = ""

    def __init__(
        self,
        folder: BatchFolder,
        assignments: tuple[str, ...],
        looker: Executor,
        runner: Executor,
        progress: BatchAudience,
    ) -> None:
        self.folder, self.assignments, self.progress = folder, assignments, progress
        self.looker, self.runner = looker, runner
        self.began, self.stop_file = time.time(), folder.stop_file()
        self.entries: dict[Path, Entry] = {}
        self.warnings: list[str] = []
        self.phase: Phase = "running"
        self.done_megapixels, self.done_seconds = _USUAL[0], _USUAL[0] * _USUAL[1] / local_workers()
        self._next_scan = self._next_page = 0.0
        self._published: Sequence[tuple[str, str]] = ()

    def until_done(self) -> BatchState:
        if self.settle_s is not None:
            self.phase = "watching"
        self._scan()
        if not self.entries and self.settle_s is None:
            self._warn(f"{self.folder.root}: no project found; one is a folder with photographs in images/")
        while True:
            self._collect()
            self._start()
            if self._is_over():
                break
            self._publish(_PUBLISH_SECONDS)
            self.progress.check()
            self._wait()
            if self.settle_s is not None and time.monotonic() >= self._next_scan:
                self._scan()
        self.phase = "finished"
        self._publish()
        return self._state()

    def end(self) -> None:
        """Stops what still runs, and leaves the page as things stand then."""
        if self.phase == "finished":
            return
        running = [e.running for e in self.entries.values() if e.running is not None]
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

    def _wait(self) -> None:
        futures: list[Future[Any]] = []
        for entry in self.entries.values():
            futures += [future for future in (entry.looking, entry.running) if future is not None]
        if futures:
            wait(futures, _TICK_SECONDS, return_when=FIRST_COMPLETED)
        else:
            time.sleep(_TICK_SECONDS)

    def _scan(self) -> None:
        """Projects that came, that went, and that changed since they were looked at."""
        roots = self.folder.projects(self._warn)
        for root in roots:
            entry = self.entries.setdefault(
                root, Entry(root, "waiting" if self.settle_s is None else "copying")
            )
            if self.settle_s is not None:
                entry.settle(self.settle_s)
        for root in self.entries.keys() - set(roots):
            if self.entries[root].running is None:
                del self.entries[root]
        self._next_scan = time.monotonic() + _SCAN_SECONDS

    # What became of those that are under way

    def _collect(self) -> None:
        for entry in self.entries.values():
            if entry.looking is not None and entry.looking.done():
                future, entry.looking = entry.looking, None
                self._looked(entry, look_of(future))
            if entry.running is not None and entry.running.done():
                finished, entry.running = entry.running, None
                self._ran(entry, outcome_of(finished))

    def _looked(self, entry: Entry, look: ProjectPreview) -> None:
        entry.look = look
        if look.up_to_date:
            entry.to("done")
        elif look.reason:
            entry.ended(Outcome("failed", 0.0, reason=look.reason, hint=look.hint), self.assignments)

    def _ran(self, entry: Entry, outcome: Outcome) -> None:
        together = any(other.running is not None for other in self.entries.values())
        if outcome.state == "busy" and entry.tries < _BUSY_TRIES:
            entry.tries += 1
            entry.to("waiting", outcome.reason, wait_s=_AGAIN_SECONDS)
        elif outcome.state == "out_of_memory" and together and not self.elsewhere:
            entry.alone = True
            entry.to("waiting", "memory ran out beside other projects: it runs again by itself")
        else:
            entry.left = outcome.state == "busy"
            entry.ended(outcome, self.assignments)
        if outcome.state == "done":
            self.done_megapixels += entry.megapixels
            self.done_seconds += outcome.seconds
        entry.release()
        if entry.changed:
            entry.again("copying")

    # What is next

    def _start(self) -> None:
        for entry in self.entries.values():
            if entry.state == "busy" and time.monotonic() >= entry.not_before:
                self._try_again(entry)
            if entry.state == "waiting" and entry.look is None and entry.looking is None:
                entry.record_before = file_stamp(entry.project.batch_record)
                entry.looking = self.looker.submit(look_at, entry.root, self.assignments)
        for entry in self.entries.values():
            running = [e for e in self.entries.values() if e.running is not None]
            if entry.is_ready and (self.most is None or len(running) < self.most):
                room = 0 if self.elsewhere else int(memory.available() * _ROOM)
                share = 0 if self.elsewhere else share_of(entry, running, room)
                if share is not None:
                    self._launch(entry, share)

    def _try_again(self, entry: Entry) -> bool:
        """Whether one that another batch had is free, and looked at anew."""
        entry.not_before = time.monotonic() + _AGAIN_SECONDS
        if entry.left or not entry.is_free():
            return False
        entry.again("waiting")
        return True

    def _launch(self, entry: Entry, share: int) -> None:
        try:
            taken = entry.take()
        except KnownError as error:
            entry.ended(Outcome("failed", 0.0, reason=str(error), hint=error.hint), self.assignments)
            return
        if not taken:
            entry.to("busy", "another batch works on it", wait_s=_AGAIN_SECONDS)
        elif entry.ended_elsewhere(self.assignments):
            entry.release()
        else:
            job = ProjectJob(str(entry.root), self.assignments, self.time_limit_s, share, str(self.stop_file))
            entry.to("running")
            entry.progress, entry.began, entry.began_s = StageProgress(), time.time(), time.monotonic()
            more = () if self.elsewhere else (entry.follow,)
            entry.running = self.runner.submit(run_job, job, *more)

    def _is_over(self) -> bool:
        states = {entry.state for entry in self.entries.values()}
        if self.settle_s is not None or states & {"waiting", "running", "copying"}:
            return False
        return not any(self._try_again(e) for e in self.entries.values() if e.state == "busy")

    # What is said of it

    def _state(self) -> BatchState:
        stopped = self.phase == "stopped"
        shown = [entry.shown(self.folder, stopped) for entry in self.entries.values()]
        return BatchState(
            root=str(self.folder.root),
            phase=self.phase,
            projects=sorted(shown, key=lambda one: one.name),
            began=time_of(self.began),
            remaining_s=remaining_of(list(self.entries.values()), self.done_seconds / self.done_megapixels),
            command=self.command,
            warnings=tuple(self.warnings),
        )

    def _publish(self, every: float = 0.0) -> None:
        """Tells the audience, and writes the page where a state changed or is older than `every` seconds."""
        state = self._state()
        self.progress.show(state)
        states = [(one.name, one.state) for one in state.projects]
        if every and states == self._published and time.monotonic() < self._next_page:
            return
        self._published, self._next_page = states, time.monotonic() + every
        looks = {self.folder.name_of(root): entry.look for root, entry in self.entries.items()}
        thumbnails = {name: look.thumbnail for name, look in looks.items() if look and look.thumbnail}
        try:
            publish(self.folder, state, thumbnails)
        except KnownError as error:
            self._warn(f"the page of the batch could not be written: {error}")

    def _warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)
            self.progress.warn(text)
