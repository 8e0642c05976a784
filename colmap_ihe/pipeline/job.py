"""One whole project, run in a process of its own: whatever its photographs do to a native library, they do to that
process and to nothing else.

`run_job` takes and returns plain values, so it may be handed to any `concurrent.futures.Executor`, here or on another
machine that sees the same folders.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from colmap_ihe.errors import KnownError
from colmap_ihe.machine import memory
from colmap_ihe.machine.child_process import ChildProcess, crash_of
from colmap_ihe.machine.files import room_on_disk
from colmap_ihe.project.folder import Project

Ending = Literal["done", "failed", "crashed", "out_of_memory", "timed_out", "busy", "stopped"]

GRACE_SECONDS = 30.0
"""For a run that was asked to stop; most take a second, and fusion in COLMAP some more."""
_TICK_SECONDS = 0.25
GOES_ON = "the same command goes on from there"
LESS_MEMORY = f"{GOES_ON}: close other programs, or lower features.max_image_size and dense.max_image_size"


@dataclass(frozen=True)
class ProjectJob:
    """Describe a run. `root` of the project; `assignments` go over its project.yaml, as those of `--set`.
    `memory_bytes`: its share, 0 for all there is. `stop_file`: the run ends soon after a file of this name appears."""

    root: str
    assignments: tuple[str, ...] = ()
    time_limit_s: float | None = None
    memory_bytes: int = 0
    stop_file: str = ""


@dataclass(frozen=True)
class Outcome:
    """Tell how a run ended, and after how long. `stage` is where, unless it is done; `reason` and `hint` say why, and
    what to do. `peak_bytes` of memory, 0 if unknown; `busy`: another run works on the project."""

    state: Ending
    seconds: float
    stage: str = ""
    reason: str = ""
    hint: str = ""
    peak_bytes: int = 0


@dataclass(frozen=True)
class StageProgress:
    """Tell how far a run is: `done` of `total` units of a stage, 0 of 0 if it does not say. `bytes`: of memory, now."""

    stage: str = ""
    done: int = 0
    total: int = 0
    bytes: int = 0


def run_job(job: ProjectJob, follow: Callable[[StageProgress], None] | None = None) -> Outcome:
    """Reconstruct one project in a process of its own, and wait for it. `follow` is told how far it is, a few times a
    second. Whatever goes wrong with the project is in the outcome: nothing is raised for it."""
    began = time.monotonic()
    try:
        project = Project.at(Path(job.root))
        with room_on_disk(project.root):
            project.records.mkdir(parents=True, exist_ok=True)
            run = _ChildRun(job, project.batch_log)
    except KnownError as error:
        return Outcome("failed", time.monotonic() - began, reason=str(error), hint=error.hint)
    except OSError as error:
        reason = f"no process could be started ({error})"
        return Outcome("failed", 0.0, reason=reason, hint="try again with fewer --jobs")
    try:
        return run.wait(follow or (lambda _progress: None))
    finally:
        run.process.end()


class _ChildRun:
    def __init__(self, job: ProjectJob, log: Path) -> None:
        self.job, self.log, self.began = job, log, time.monotonic()
        with log.open("w+b") as errors:
            self.process = ChildProcess(
                "colmap_ihe.pipeline.job_main", json.dumps(asdict(job)), errors=errors.fileno(), piped=True
            )
        self.progress = StageProgress()
        self.ended: dict[str, Any] = {}
        self.peak = 0
        self.asked: Ending | None = None
        self.killed = False

    def wait(self, follow: Callable[[StageProgress], None]) -> Outcome:
        until = float("inf")
        for line in self.process.lines(_TICK_SECONDS):
            if line.endswith(b"\n"):  # else it ended within it
                self._hear(json.loads(line))
            now, peak = memory.taken(self.process.pid)
            self.peak = max(self.peak, peak)
            self.progress = replace(self.progress, bytes=now)
            follow(self.progress)
            if self.asked is None and (asked := self._to_stop()):
                self.asked, until = asked, time.monotonic() + GRACE_SECONDS
                self.process.close_lifeline()
            if time.monotonic() > until:
                self.killed = True
                self.process.kill()
        self.process.status(GRACE_SECONDS)
        return self._outcome()

    def _hear(self, message: dict[str, Any]) -> None:
        if "ended" in message:
            self.ended = message["ended"]
        else:
            self.progress = StageProgress(**message)

    def _to_stop(self) -> Ending | None:
        if self.job.stop_file and Path(self.job.stop_file).exists():
            return "stopped"
        limit = self.job.time_limit_s
        return "timed_out" if limit is not None and time.monotonic() - self.began > limit else None

    def _outcome(self) -> Outcome:
        state, reason, hint = self._ending()
        stage = "" if state == "done" else self.progress.stage
        seconds = round(time.monotonic() - self.began, 2)
        return Outcome(state, seconds, stage, reason, hint, self.peak)

    def _ending(self) -> tuple[Ending, str, str]:
        state = self.ended.get("state")
        if self.asked and state in (None, "stopped"):
            if self.asked == "timed_out":
                limit = self.job.time_limit_s or 0
                reason = f"not done within the time limit of {limit / 60:.4g} min{self._where()}"
                return "timed_out", reason, f"{GOES_ON}; give it a longer --time-limit"
            return "stopped", f"stopped{self._where()}", GOES_ON
        if state is not None:
            return state, self.ended["reason"], self.ended["hint"]
        return self._crash()

    def _crash(self) -> tuple[Ending, str, str]:
        status, words = self.process.status(), self.process.words()
        crash = crash_of(status)
        if crash == "SIGKILL" and not self.killed:
            reason = f"killed by the system{self._where()}, as it does when memory runs out"
            return "out_of_memory", reason, LESS_MEMORY
        if "bad_alloc" in words or "MemoryError" in words:
            return "out_of_memory", f"memory ran out{self._where()}", LESS_MEMORY
        if crash == "SIGTERM":
            return "stopped", f"stopped from elsewhere{self._where()} (SIGTERM)", GOES_ON
        hint = f"{GOES_ON}; if it crashes again see {self.log} and records/colmap.log.*"
        if crash:
            return "crashed", f"crashed{self._where()} ({crash})", hint
        last = words.strip().splitlines()[-1:] or ["it said nothing"]
        return "crashed", f"ended without a result{self._where()}, exit status {status}: {last[0]:.300}", hint

    def _where(self) -> str:
        return f" in {self.progress.stage}" if self.progress.stage else ""
