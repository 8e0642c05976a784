"""Batches: what runs and what waits, what is locked, and what is left when a project breaks."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from batches import Listener, projects, states
from command_line import Captured

from colmap_ihe.batch import driver
from colmap_ihe.batch.driver import batch
from colmap_ihe.batch.preview import ProjectPreview
from colmap_ihe.batch.state import BatchState
from colmap_ihe.cli import main
from colmap_ihe.errors import Cancelled, OptionError
from colmap_ihe.machine import locks, memory
from colmap_ihe.machine.files import read_json
from colmap_ihe.pipeline.job import Outcome, ProjectJob, StageProgress
from colmap_ihe.project.folder import Project

GB = 10**9
Patch = pytest.MonkeyPatch
Endings = dict[str, list[Outcome]]


class Pretended(NamedTuple):
    endings: Endings
    jobs: list[ProjectJob]


@pytest.fixture
def pretended(monkeypatch: Patch) -> Pretended:
    """Runs that take a moment and end as told, by name of the project, or else well; and the jobs that were run."""
    endings: Endings = {}
    jobs: list[ProjectJob] = []

    def run(job: ProjectJob, _follow: Callable[[StageProgress], None] | None = None) -> Outcome:
        jobs.append(job)
        time.sleep(0.05)
        left = endings.get(Path(job.root).name)
        return left.pop(0) if left else Outcome("done", 0.05)

    monkeypatch.setattr(driver, "run_job", run)
    monkeypatch.setattr(driver, "preview_project", lambda *_: ProjectPreview(8, 10**6, GB))
    monkeypatch.setattr(driver, "_TICK_SECONDS", 0.02)
    monkeypatch.setattr(driver, "_BUSY_SECONDS", 0.01)
    monkeypatch.setattr(memory, "available", lambda: 100 * GB)
    return Pretended(endings, jobs)


def test_a_slip_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="unknown option"):
        batch(projects(tmp_path, "a"), assignments=["fit.steps=1"], progress=Listener())
    assert not (tmp_path / "batch").exists()


def test_one_that_fails_does_not_stop_others(tmp_path: Path, pretended: Pretended, capsys: Captured) -> None:
    endings, jobs = pretended
    endings["b"] = [Outcome("crashed", 1.0, "matches", "crashed in matches (SIGSEGV)", "again", 2 * GB)]
    root = projects(tmp_path, "a", "b", "c/d")
    assert main(["batch", str(root), "--json", "--set", "fit.step=0.1"]) == 1
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1].startswith("colmap-ihe: 1 of 3 projects are not done")
    result = json.loads(printed.out)
    assert json.loads((root / "batch/batch.json").read_text())["projects"] == result["projects"]
    assert (result["state"], result["counts"]) == ("finished", {"done": 2, "crashed": 1})
    assert [p["name"] for p in result["projects"]] == ["a", "b", "c/d"]
    assert result["projects"][1]["reason"] == "crashed in matches (SIGSEGV)"
    assert result["projects"][1]["peak_memory_gb"] == 2
    record = read_json(root / "b/records/batch.json") or {}
    assert (record["state"], record["stage"], record["seconds"]) == ("crashed", "matches", 1.0)
    assert all(job.assignments == ("fit.step=0.1",) for job in jobs)
    page = (root / "batch/index.html").read_text()
    assert "What needs you" in page and "crashed in matches (SIGSEGV)" in page
    assert 'http-equiv="refresh"' not in page
    assert sorted(p.name for p in (root / "batch").iterdir()) == [locks.MARK, "batch.json", "index.html"]


def test_after_memory_ran_out_it_runs_alone(tmp_path: Path, pretended: Pretended, monkeypatch: Patch) -> None:
    endings, jobs = pretended
    endings["a"] = [Outcome("out_of_memory", 1.0, reason="memory ran out")]
    held = threading.Event()
    pretended_run: Callable[..., Outcome] = getattr(driver, "run_job")  # noqa: B009  of the fixture

    def run(job: ProjectJob, follow: Callable[[StageProgress], None] | None = None) -> Outcome:
        if Path(job.root).name == "b":
            held.wait(20)
        return pretended_run(job, follow)

    monkeypatch.setattr(driver, "run_job", run)

    class Freeing(Listener):
        def show(self, state: BatchState) -> None:
            if any("runs again by itself" in p.reason for p in state.projects):
                held.set()
            super().show(state)

    done = batch(projects(tmp_path, "a", "b", "c"), jobs=2, progress=Freeing())
    assert set(states(done).values()) == {"done"}
    (last,) = [job for job in jobs[2:] if Path(job.root).name == "a"]
    assert last.memory_bytes == int(100 * GB * 0.9)  # all there is
    assert jobs[0].memory_bytes == GB


def test_a_gpu_has_one_at_a_time(tmp_path: Path, pretended: Pretended, monkeypatch: Patch) -> None:
    def most_at_once() -> int:
        display = Listener()
        root = projects(tmp_path / str(len(pretended.jobs)), "a", "b", "c", "d")
        assert batch(root, progress=display).succeeded
        return max(list(states(state).values()).count("running") for state in display.states)

    monkeypatch.setattr(driver, "local_workers", lambda: 3)
    assert most_at_once() == 3
    monkeypatch.setattr(driver, "pick_backend", lambda _wanted: "patchmatch")
    assert most_at_once() == 1


def test_memory_that_ran_out_alone_is_a_failure(tmp_path: Path, pretended: Pretended) -> None:
    endings, jobs = pretended
    endings["a"] = [Outcome("out_of_memory", 1.0, reason="memory ran out", hint="fewer")]
    done = batch(projects(tmp_path, "a"), progress=Listener())
    assert states(done) == {"a": "out_of_memory"} and not done.succeeded and len(jobs) == 1


def test_a_locked_project_is_skipped(tmp_path: Path, pretended: Pretended) -> None:
    root = projects(tmp_path, "a", "b")
    with Project.at(root / "a").locked():
        done = batch(root, progress=Listener())
    assert states(done) == {"a": "busy", "b": "done"}
    assert "another run is working on this project" in done.projects[0].reason and not done.succeeded
    assert [Path(job.root).name for job in pretended.jobs] == ["b"]
    assert states(batch(root, progress=Listener())) == {"a": "done", "b": "done"}


def test_a_run_that_a_killed_batch_left_is_waited_for(tmp_path: Path, pretended: Pretended) -> None:
    endings, jobs = pretended
    busy = Outcome("busy", 0.1, reason="another run is working on this project")
    endings["a"], endings["b"] = [busy] * 3, [busy] * 99
    done = batch(projects(tmp_path, "a", "b"), progress=Listener())
    assert states(done) == {"a": "done", "b": "busy"}
    assert len([job for job in jobs if job.root.endswith("b")]) == 6


@pytest.mark.parametrize(
    ("preview", "state"),
    [(ProjectPreview(8, 0, 0, up_to_date=True), "done"), (ProjectPreview(reason="no photograph"), "failed")],
)
def test_nothing_is_started_for_what_needs_none(
    tmp_path: Path, pretended: Pretended, monkeypatch: pytest.MonkeyPatch, preview: ProjectPreview, state: str
) -> None:
    monkeypatch.setattr(driver, "preview_project", lambda *_: preview)
    assert states(batch(projects(tmp_path, "a"), progress=Listener())) == {"a": state}
    assert not pretended[1]


@pytest.mark.usefixtures("pretended")
def test_an_executor_may_run_projects_elsewhere(tmp_path: Path) -> None:
    class Lossy(Executor):
        """Loses the worker that has `b`."""

        def __init__(self) -> None:
            self.given: list[tuple[Any, ...]] = []

        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            self.given.append(args)
            future: Future[Any] = Future()
            if args[0].root.endswith("b"):
                future.set_exception(RuntimeError("the worker is gone"))
            else:
                future.set_result(fn(*args, **kwargs))
            return future

    lossy = Lossy()
    done = batch(projects(tmp_path, "a", "b", "c"), executor=lossy, progress=Listener())
    assert states(done) == {"a": "done", "b": "crashed", "c": "done"}
    assert "the worker is gone" in done.projects[1].reason
    assert [len(given) for given in lossy.given] == [1, 1, 1]  # plain values alone
    assert all(given[0].memory_bytes == 0 for given in lossy.given)  # its memory is its own affair


@pytest.mark.usefixtures("pretended")
def test_stopped_by_hand_it_says_so_and_ends_its_runs(tmp_path: Path, monkeypatch: Patch) -> None:
    def run(job: ProjectJob, _follow: Callable[[StageProgress], None] | None = None) -> Outcome:
        end = time.monotonic() + 20
        while not Path(job.stop_file).exists():
            assert time.monotonic() < end
            time.sleep(0.01)
        return Outcome("stopped", 0.1, "fit", "stopped in fit", "goes on")

    monkeypatch.setattr(driver, "run_job", run)
    root = projects(tmp_path, "a", "b")
    with pytest.raises(Cancelled):
        batch(root, jobs=1, progress=Listener(lambda state: "running" in states(state).values()))
    result = json.loads((root / "batch/batch.json").read_text())
    assert result["state"] == "stopped"
    assert [p["state"] for p in result["projects"]] == ["stopped", "stopped"]
    assert not list((root / "batch").glob("stop-*"))


def test_new_projects_wait_for_still_files(tmp_path: Path, pretended: Pretended, monkeypatch: Patch) -> None:
    monkeypatch.setattr(driver, "_SCAN_SECONDS", 0.05)
    root = projects(tmp_path, "a")
    copies = 0

    class Copying(Listener):
        """Puts `b` there when `a` is done, a file at a time, and one more into `a` when that is done too."""

        def show(self, state: BatchState) -> None:
            nonlocal copies
            super().show(state)
            now = states(state)
            if now.get("a") == "done" and copies < 12:
                (root / "b/images").mkdir(parents=True, exist_ok=True)
                (root / f"b/images/{copies}.jpg").touch()
                copies += 1
                time.sleep(0.05)
            if now.get("b") == "done" and copies == 12:
                (root / "a/images/later.jpg").touch()
                copies += 1

    def over(state: BatchState) -> bool:
        return len(jobs) == 3 and set(states(state).values()) == {"done"}

    jobs = pretended[1]
    listener = Copying(over)
    with pytest.raises(Cancelled):
        batch(root, watch=True, settle_s=0.3, progress=listener)
    assert [Path(job.root).name for job in jobs] == ["a", "b", "a"]
    while_copied = [states(s)["b"] for s in listener.states if "b" in states(s)]
    assert while_copied[0] == "copying" and "running" in while_copied
    assert {s.phase for s in listener.states[:-1]} == {"watching"}
