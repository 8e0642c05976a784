"""A project on its way through a batch: what is known of it, who has it, and how much memory its run may take."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from colmap_ihe.batch.folder import BatchFolder, contents_of
from colmap_ihe.batch.preview import BASE_BYTES, ProjectPreview
from colmap_ihe.batch.state import FAILURES, ProjectState, State, project_state, time_of
from colmap_ihe.errors import KnownError
from colmap_ihe.machine import locks as ours
from colmap_ihe.machine.files import file_stamp, read_json, room_on_disk, write_json
from colmap_ihe.pipeline.job import GOES_ON, Outcome, StageProgress
from colmap_ihe.project.folder import Project

_START_MEGAPIXELS = 2.0


@dataclass
class Entry:
    """`not_before`: when it may be tried next, and `tries` so far at one that another run works on; `left` to that run.
    `began` by the clock on the wall, `began_s` by one that never jumps. `alone`: memory ran out beside others.
    `changed` while it ran. `record_before`: the stamp of its record when it began to be looked at."""

    root: Path
    state: State = "waiting"
    reason: str = ""
    hint: str = ""
    look: ProjectPreview | None = None
    looking: Future[ProjectPreview] | None = None
    running: Future[Outcome] | None = None
    progress: StageProgress = field(default_factory=StageProgress)
    began: float = 0.0
    began_s: float = 0.0
    not_before: float = 0.0
    tries: int = 0
    left: bool = False
    alone: bool = False
    changed: bool = False
    record_before: tuple[int, ...] = ()
    _lock: IO[str] | None = None
    _contents: str = ""
    _since: float = 0.0
    _shown: ProjectState | None = None

    @property
    def project(self) -> Project:
        return Project(self.root, self.root / "images")

    @property
    def need(self) -> int:
        return self.look.need_bytes if self.look else 0

    @property
    def megapixels(self) -> float:
        """With what every run takes, however small its photographs are."""
        return _START_MEGAPIXELS + (self.look.pixels / 1e6 if self.look else 0.0)

    @property
    def is_ready(self) -> bool:
        return self.state == "waiting" and self.look is not None and time.monotonic() >= self.not_before

    def to(self, state: State, reason: str = "", hint: str = "", wait_s: float = 0.0) -> None:
        self.state, self.reason, self.hint = state, reason, hint
        self.not_before = time.monotonic() + wait_s
        self._shown = None

    def again(self, state: State) -> None:
        """As if it were new."""
        self.to(state)
        self.look = self.looking = None
        self.changed = False

    def settle(self, settle_s: float) -> None:
        """One whose files changed waits until they have not for so many seconds."""
        contents, newest = contents_of(self.project)
        if contents != self._contents:
            known = bool(self._contents)
            # The clock of the disk counts once, for a folder that lay there before; it need not be right.
            before = 0.0 if known else max(0.0, time.time() - newest)
            self._contents, self._since = contents, time.monotonic() - before
            if known and self.running is not None:
                self.changed = True
            elif known:
                self.again("copying")
        if self.state == "copying" and time.monotonic() - self._since >= settle_s:
            self.to("waiting")

    # Who has it

    def take(self) -> bool:
        """Whether it is ours now, and no other batch's. Raises `KnownError`, where it cannot be written to."""
        self.project.refuse_links()
        with room_on_disk(self.root):
            self._lock = ours.acquire_lock(self.project.batch_lock)
        return self._lock is not None

    def release(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def is_free(self) -> bool:
        """Whether no batch has it."""
        with suppress(KnownError):
            taken = self.take()
            self.release()
            return taken
        return False

    def ended(self, outcome: Outcome, assignments: Sequence[str]) -> None:
        """Keeps how a run with these options ended, for this batch and for others."""
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
            self.record_before = file_stamp(self.project.batch_record)

    def ended_elsewhere(self, assignments: Sequence[str]) -> bool:
        """Whether another batch ran it with these options since it was looked at; it is then what it became there."""
        with suppress(OSError):
            record = read_json(self.project.batch_record) or {}
            if (
                self.look is not None
                and file_stamp(self.project.batch_record) != self.record_before
                and record.get("set") == list(assignments)
                and str(record.get("state")) in ("done", *FAILURES)
            ):
                self.to(record["state"], str(record.get("reason", "")), str(record.get("hint", "")))
                return True
        return False

    # How it is seen

    def follow(self, progress: StageProgress) -> None:
        self.progress = progress

    def shown(self, folder: BatchFolder, stopped: bool) -> ProjectState:
        if self._shown is None or stopped or self.state in ("running", "busy"):
            self._shown = self._show(folder, stopped)
        return self._shown

    def _show(self, folder: BatchFolder, stopped: bool) -> ProjectState:
        state: State = (
            "stopped" if stopped and self.state in ("waiting", "copying", "running") else self.state
        )
        known: dict[str, Any] = {"reason": self.reason, "hint": self.hint}
        if self.look is not None:
            known["photographs"] = self.look.photographs
        if state == "running":
            known |= {
                "stage": self.progress.stage or self.project.stage_begun(),
                "progress": (self.progress.done, self.progress.total),
            }
            known |= {"began": time_of(self.began), "ended": None, "seconds": None, "peak_memory_gb": None}
        return project_state(folder, self.project, state, **known)


def share_of(entry: Entry, running: Sequence[Entry], room: int) -> int | None:
    """Bytes that a run of `entry` may take beside those that run, 0 for no bound; None if it has to wait.

    `room` is what is free now, 0 if unknown. What runs takes what it has, and will take what it needs.
    """
    if not running:
        return room if entry.alone or entry.need > room else max(BASE_BYTES, min(entry.need or room, room))
    if entry.alone or any(one.alone for one in running):
        return None
    if not room:
        return 0
    room -= sum(max(0, one.need - one.progress.bytes) for one in running)
    return entry.need if 0 < entry.need <= room else None


def remaining_of(entries: Sequence[Entry], pace: float) -> float | None:
    """Seconds until all are done, at `pace` seconds a megapixel; None before all were looked at."""
    left = [entry for entry in entries if entry.state in ("waiting", "running")]
    if not left or any(entry.look is None for entry in left):
        return None
    running = [e for e in left if e.state == "running"]
    under_way = [max(0.0, e.megapixels * pace - (time.monotonic() - e.began_s)) for e in running]
    ahead = [e.megapixels * pace for e in left if e.state == "waiting"]
    return max([sum(under_way + ahead) / max(1, len(running)), *under_way])


def look_of(future: Future[ProjectPreview]) -> ProjectPreview:
    """What an ended look found, also if it broke."""
    try:
        return future.result()
    except Exception as error:  # noqa: BLE001  of one project, and the others go on
        return ProjectPreview(reason=f"it could not be looked at: {type(error).__name__}: {error}")


def outcome_of(future: Future[Outcome]) -> Outcome:
    """How a run ended, also if it was lost."""
    if future.cancelled():
        return Outcome("stopped", 0.0, reason="stopped before it began", hint=GOES_ON)
    try:
        return future.result()
    except Exception as error:  # noqa: BLE001  an executor that lost a worker, say
        return Outcome(
            "crashed", 0.0, reason=f"its run was lost: {type(error).__name__}: {error}", hint=GOES_ON
        )
