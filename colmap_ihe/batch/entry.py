"""Keep what a batch knows of one project, share memory out to its run, and estimate what remains of all."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from colmap_ihe.batch.folder import BatchFolder, contents_of
from colmap_ihe.batch.preview import ProjectPreview
from colmap_ihe.batch.state import ProjectState, State, project_state, time_of
from colmap_ihe.errors import KnownError
from colmap_ihe.machine.files import write_json
from colmap_ihe.pipeline.job import Outcome, StageProgress
from colmap_ihe.project.folder import Project

_START_MEGAPIXELS = 2.0


@dataclass
class Entry:
    """Hold the state of a project, its preview and its run.

    `began`: seconds since the epoch; `began_s`, `not_before`: of the monotonic clock. `tries`: at a project that
    another run works on. `alone`: memory ran out beside others. `changed`: its files changed while it ran.
    """

    root: Path
    state: State = "waiting"
    reason: str = ""
    hint: str = ""
    preview: ProjectPreview | None = None
    previewing: Future[ProjectPreview] | None = None
    running: Future[Outcome] | None = None
    progress: StageProgress = field(default_factory=StageProgress)
    began: float = 0.0
    began_s: float = 0.0
    not_before: float = 0.0
    tries: int = 0
    alone: bool = False
    changed: bool = False
    _contents: str = ""
    _unchanged_since: float = 0.0
    _shown: ProjectState | None = None

    @property
    def project(self) -> Project:
        return Project(self.root, self.root / "images")

    @property
    def need(self) -> int:
        """Return the bytes of memory that its run takes, 0 if unknown."""
        return self.preview.memory_bytes if self.preview else 0

    @property
    def megapixels(self) -> float:
        """Return its megapixels, and what every run takes, however small its photographs are."""
        return _START_MEGAPIXELS + (self.preview.pixels / 1e6 if self.preview else 0.0)

    @property
    def may_begin(self) -> bool:
        return self.state == "waiting" and time.monotonic() >= self.not_before

    def to(self, state: State, reason: str = "", hint: str = "") -> None:
        """Change the state."""
        self.state, self.reason, self.hint = state, reason, hint
        self._shown = None

    def begin_anew(self, state: State, reason: str = "", wait_s: float = 0.0) -> None:
        """Wait for so many seconds for a new preview, and then for a run."""
        self.to(state, reason)
        self.preview = self.previewing = None
        self.not_before = time.monotonic() + wait_s
        self.changed = False

    def settle(self, settle_s: float) -> None:
        """Let a project wait while its files change, and until they have not for so many seconds."""
        contents, newest = contents_of(self.project)
        if contents != self._contents:
            is_new = not self._contents
            # The clock of the disk counts once, for a folder that lay there before; it need not be right.
            age = max(0.0, time.time() - newest) if is_new else 0.0
            self._contents, self._unchanged_since = contents, time.monotonic() - age
            if self.running is not None:
                self.changed = True
            elif not is_new:
                self.begin_anew("copying")
        if self.state == "copying" and time.monotonic() - self._unchanged_since >= settle_s:
            self.to("waiting")

    def end(self, outcome: Outcome, assignments: Sequence[str]) -> None:
        """Take over how a run with these options ended, and write it to the project's records."""
        self.to(outcome.state, outcome.reason, outcome.hint)
        record = {
            "state": outcome.state,
            "set": list(assignments),
            "stage": outcome.stage,
            "reason": outcome.reason,
            "hint": outcome.hint,
            "seconds": outcome.seconds,
            "peak_memory_gb": round(outcome.peak_bytes / 1e9, 2) or None,
            "began": time_of(self.began) if self.began else None,
            "ended": time_of(time.time()),
        }
        with suppress(KnownError, OSError):  # nothing can be written there, which is then its reason
            self.project.refuse_links()
            write_json(self.project.batch_record, record)

    def follow(self, progress: StageProgress) -> None:
        """Note how far its run is."""
        self.progress = progress

    def shown(self, folder: BatchFolder, stopped: bool) -> ProjectState:
        """Return its state for the page; `stopped`: of a batch that was stopped."""
        if self._shown is None or stopped or self.state == "running":
            self._shown = self._show(folder, stopped)
        return self._shown

    def _show(self, folder: BatchFolder, stopped: bool) -> ProjectState:
        is_open = self.state in ("waiting", "copying", "running")
        state: State = "stopped" if stopped and is_open else self.state
        values: dict[str, Any] = {"reason": self.reason, "hint": self.hint}
        if self.preview is not None:
            values["photographs"] = self.preview.photographs
        if state == "running":
            stage, units = self.progress.stage, (self.progress.done, self.progress.total)
            values |= {"stage": stage or self.project.stage_begun(), "progress": units}
            values |= {"began": time_of(self.began), "ended": None, "seconds": None, "peak_memory_gb": None}
        return project_state(folder, self.project, state, **values)


def share_of(entry: Entry, running: Sequence[Entry], room: int) -> int | None:
    """Return the bytes that a run of `entry` may take beside those that run, 0 for no limit; None if it has to wait.
    `room` is what is free now, 0 if unknown. What runs takes what it has, and will take what it needs."""
    if not running:
        return room if entry.alone else min(entry.need or room, room)
    if entry.alone or any(other.alone for other in running):
        return None
    if not room:
        return 0
    room -= sum(max(0, other.need - other.progress.bytes) for other in running)
    return entry.need if 0 < entry.need <= room else None


def remaining_of(entries: Sequence[Entry], pace: float) -> float | None:
    """Return the seconds until all are done, at `pace` seconds a megapixel; None before each has a preview."""
    left = [entry for entry in entries if entry.state in ("waiting", "running")]
    if not left or any(entry.preview is None for entry in left):
        return None
    running = [e for e in left if e.state == "running"]
    under_way = [max(0.0, e.megapixels * pace - (time.monotonic() - e.began_s)) for e in running]
    ahead = [e.megapixels * pace for e in left if e.state == "waiting"]
    return max([sum(under_way + ahead) / max(1, len(running)), *under_way])
