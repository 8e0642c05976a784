"""Batches: what runs and what waits, what others have, and what is left when one of them breaks."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from small_demo import QUICK, ROOT

from colmap_ihe.batch import driver
from colmap_ihe.batch.driver import batch
from colmap_ihe.batch.entry import Entry, remaining_of, share_of
from colmap_ihe.batch.folder import BatchFolder, contents_of
from colmap_ihe.batch.preview import BASE_BYTES, ProjectPreview, look_at, need_of
from colmap_ihe.batch.state import BatchState
from colmap_ihe.cli import main
from colmap_ihe.commandline.arguments import parser_of
from colmap_ihe.commandline.commands import RUNS
from colmap_ihe.errors import Cancelled, OptionError, ProjectError
from colmap_ihe.machine import locks as ours
from colmap_ihe.machine import memory
from colmap_ihe.machine.files import read_json, write_json
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.exif.metadata import Metadata
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.job import Outcome, ProjectJob, StageProgress
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import load_options

GB = 10**9
SETTINGS = [part for assignment in QUICK for part in ("--set", assignment)]


class Listener:
    """Follows a batch, and stops it after `most` seconds or when `until` holds."""

    def __init__(self, until: Callable[[BatchState], bool] = lambda _state: False, most: float = 60) -> None:
        self.states: list[BatchState] = []
        self.warnings: list[str] = []
        self._until, self._end = until, time.monotonic() + most

    def check(self) -> None:
        assert time.monotonic() < self._end, self.states[-1]
        if self.states and self._until(self.states[-1]):
            raise Cancelled

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def show(self, state: BatchState) -> None:
        self.states.append(state)


def projects(root: Path, *names: str) -> Path:
    for name in names:
        (root / name / "images").mkdir(parents=True)
        (root / name / "images/a.jpg").touch()
    return root


def states(state: BatchState) -> dict[str, str]:
    return {project.name: project.state for project in state.projects}


Endings = dict[str, list[Outcome]]


class Pretended(NamedTuple):
    endings: Endings
    jobs: list[ProjectJob]


@pytest.fixture
def pretended(monkeypatch: pytest.MonkeyPatch) -> Pretended:
    """Runs that take a moment and end as told, by name of the project, or else well; and the jobs that were run."""
    endings: Endings = {}
    jobs: list[ProjectJob] = []

    def run(job: ProjectJob, _follow: Callable[[StageProgress], None] | None = None) -> Outcome:
        jobs.append(job)
        time.sleep(0.05)
        left = endings.get(Path(job.root).name)
        return left.pop(0) if left else Outcome("done", 0.05)

    monkeypatch.setattr(driver, "run_job", run)
    monkeypatch.setattr(driver, "look_at", lambda *_: ProjectPreview(8, 10**6, GB))
    monkeypatch.setattr(driver, "_TICK_SECONDS", 0.02)
    monkeypatch.setattr(memory, "available", lambda: 100 * GB)
    return Pretended(endings, jobs)


# What is a project


def test_projects_are_found_at_any_depth_and_not_in_what_was_made(tmp_path: Path) -> None:
    root = projects(
        tmp_path / "root", "b", "a/deep/c", ".hidden/d", "b/images/inner", "e/workspace", "made/dense"
    )
    ours.make(root / "e/workspace")
    ours.make(root / "made")
    (root / "f").mkdir()
    (root / "link").symlink_to(tmp_path / "elsewhere")
    projects(tmp_path / "elsewhere", "g")
    (root / "a/loop").symlink_to(root)
    folder = BatchFolder.at(root)
    assert [folder.name_of(p) for p in folder.projects(pytest.fail)] == ["a/deep/c", "b", "link/g"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_folder_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "shut").mkdir(mode=0)
    said: list[str] = []
    assert BatchFolder.at(tmp_path).projects(said.append) == []
    assert "shut: cannot be read" in said[0]


def test_a_project_is_no_root_and_a_folder_of_somebody_else_is_not_written_to(tmp_path: Path) -> None:
    root = projects(tmp_path, "a")
    with pytest.raises(ProjectError, match="is a project itself"):
        BatchFolder.at(root / "a")
    with pytest.raises(ProjectError, match="no such folder"):
        BatchFolder.at(root / "nowhere")
    (root / "batch").mkdir()
    (root / "batch/notes.txt").touch()
    with pytest.raises(ProjectError, match="was not made by colmap-ihe"):
        batch(root, progress=Listener())
    assert [p.name for p in (root / "batch").iterdir()] == ["notes.txt"]


def test_a_slip_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="unknown option"):
        batch(projects(tmp_path, "a"), assignments=["fit.steps=1"], progress=Listener())
    assert not (tmp_path / "batch").exists()


@pytest.mark.parametrize(
    "said", [["--jobs", "0"], ["--time-limit", "soon"], ["--time-limit", "0h"], ["--settle", "30"]]
)
def test_other_lengths_and_counts_are_wrong_usage(
    said: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["batch", ".", *said])
    assert caught.value.code == 2
    assert "wanted a" in capsys.readouterr().err


def test_lengths_of_time_have_units() -> None:
    parser = parser_of(RUNS)
    for said, seconds in (("45s", 45), ("1.5m", 90), ("2h", 7200)):
        assert parser.parse_args(["batch", ".", "--time-limit", said]).time_limit == seconds


# Memory and time


def entry(need: int = 0, **more: Any) -> Entry:
    return Entry(Path("p"), look=ProjectPreview(10, 8 * 10**6, need), **more)


def test_as_many_at_a_time_as_memory_has_room_for() -> None:
    held = entry(4 * GB, progress=StageProgress(bytes=GB))
    assert share_of(entry(2 * GB), [], 10 * GB) == 2 * GB
    assert share_of(entry(2 * GB), [held], 6 * GB) == 2 * GB  # 3 GB are still to be taken
    assert share_of(entry(4 * GB), [held], 6 * GB) is None
    assert share_of(entry(20 * GB), [], 6 * GB) == 6 * GB  # alone it may try with what there is
    assert share_of(entry(GB, alone=True), [held], 60 * GB) is None
    assert share_of(entry(GB), [entry(GB, alone=True)], 60 * GB) is None
    assert share_of(entry(GB, alone=True), [], 60 * GB) == 60 * GB
    assert share_of(entry(GB), [held], 0) == 0  # the system does not say
    assert share_of(entry(1), [], 60 * GB) == BASE_BYTES


def test_a_run_keeps_within_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    now, most = memory.taken("self")
    assert 0 < now <= most
    free = memory.available()
    monkeypatch.setattr(memory, "_share", 0)
    memory.keep_within(now + 50_000_000)
    assert 1 <= memory.available() <= 60_000_000 < free
    memory.keep_within(1)
    assert memory.available() == 1
    assert memory.taken(2**22 + 1) == (0, 0)


def test_need_grows_with_pixels_and_falls_with_options() -> None:
    def need(width: int, height: int, *assignments: str) -> int:
        one = Surveyed(Capture("a.jpg", Path("a.jpg"), "coded", "a"), width, height, Metadata())
        return need_of([one], load_options(None, assignments)) - BASE_BYTES

    cores = local_workers()
    assert need(2832, 2128) == pytest.approx(290 * 2832 * 2128 * cores, rel=1e-6)  # 280 a pixel measured
    assert need(6400, 4800) == pytest.approx(290 * 3200 * 2400 * cores, rel=1e-6)  # COLMAP shrinks it
    one_thread = need(2832, 2128, "features.colmap.num_threads=1", "dense.enabled=false")
    assert one_thread == pytest.approx(290 * 2832 * 2128, rel=1e-6)
    small = need(2832, 2128, "features.colmap.sift.first_octave=0", "dense.enabled=false")
    assert small == pytest.approx(290 / 4 * 2832 * 2128 * cores, rel=1e-6)


def test_remaining_time_is_by_megapixels() -> None:
    running = entry(state="running", began_s=time.monotonic() - 30)
    assert remaining_of([running, entry()], 10) == pytest.approx(70 + 100, abs=1)
    assert remaining_of([running, running, entry()], 10) == pytest.approx((70 + 70 + 100) / 2, abs=1)
    assert remaining_of([entry(), Entry(Path("q"))], 10) is None
    assert remaining_of([entry(state="done")], 10) is None


# What becomes of them


def test_one_that_fails_does_not_stop_the_others(
    tmp_path: Path, pretended: Pretended, capsys: pytest.CaptureFixture[str]
) -> None:
    endings, jobs = pretended
    endings["b"] = [Outcome("crashed", 1.0, "matches", "crashed in matches (SIGSEGV)", "again", 2 * GB)]
    root = projects(tmp_path, "a", "b", "c/d")
    assert main(["batch", str(root), "--json", "--set", "fit.step=0.1"]) == 1
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1].startswith("colmap-ihe: 1 of 3 projects are not done")
    found = json.loads(printed.out)
    assert json.loads((root / "batch/batch.json").read_text())["projects"] == found["projects"]
    assert (found["state"], found["counts"]) == ("finished", {"done": 2, "crashed": 1})
    assert [p["name"] for p in found["projects"]] == ["a", "b", "c/d"]
    assert found["projects"][1]["reason"] == "crashed in matches (SIGSEGV)"
    assert found["projects"][1]["peak_memory_gb"] == 2
    record = read_json(root / "b/records/batch.json") or {}
    assert (record["state"], record["stage"], record["seconds"]) == ("crashed", "matches", 1.0)
    assert all(job.assignments == ("fit.step=0.1",) for job in jobs)
    page = (root / "batch/index.html").read_text()
    assert "What needs you" in page and "crashed in matches (SIGSEGV)" in page
    assert 'http-equiv="refresh"' not in page
    assert sorted(p.name for p in (root / "batch").iterdir()) == [ours.MARK, "batch.json", "index.html"]


def test_memory_that_ran_out_beside_others_is_tried_again_alone(
    tmp_path: Path, pretended: Pretended, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_with_a_gpu_one_at_a_time(
    tmp_path: Path, pretended: Pretended, monkeypatch: pytest.MonkeyPatch
) -> None:
    def most_at_once() -> int:
        follower = Listener()
        root = projects(tmp_path / str(len(pretended.jobs)), "a", "b", "c", "d")
        assert batch(root, progress=follower).succeeded
        return max(list(states(state).values()).count("running") for state in follower.states)

    monkeypatch.setattr(driver, "local_workers", lambda: 3)
    assert most_at_once() == 3
    monkeypatch.setattr(driver, "pick_backend", lambda _wanted: "patchmatch")
    assert most_at_once() == 1


def test_memory_that_ran_out_alone_is_a_failure(tmp_path: Path, pretended: Pretended) -> None:
    endings, jobs = pretended
    endings["a"] = [Outcome("out_of_memory", 1.0, reason="memory ran out", hint="fewer")]
    done = batch(projects(tmp_path, "a"), progress=Listener())
    assert states(done) == {"a": "out_of_memory"} and not done.succeeded and len(jobs) == 1


def test_what_another_batch_has_is_left_to_it(tmp_path: Path, pretended: Pretended) -> None:
    root = projects(tmp_path, "a", "b")
    lock = ours.acquire_lock(root / "a/records/batch.lock")
    assert lock is not None
    with lock:
        done = batch(root, progress=Listener())
    assert states(done) == {"a": "busy", "b": "done"}
    assert done.projects[0].reason == "another batch works on it" and not done.succeeded
    assert [Path(job.root).name for job in pretended[1]] == ["b"]
    assert states(batch(root, progress=Listener())) == {"a": "done", "b": "done"}


@pytest.mark.parametrize(("with_options", "state"), [(["fit.step=0.1"], "crashed"), ([], "done")])
def test_what_another_batch_made_of_it_meanwhile_counts(
    tmp_path: Path,
    pretended: Pretended,
    monkeypatch: pytest.MonkeyPatch,
    with_options: list[str],
    state: str,
) -> None:
    """It crashed there a moment ago: trying again at once would be the same work twice, unless options differ."""
    root = projects(tmp_path, "a")
    theirs = {"state": "crashed", "set": with_options, "reason": "crashed in sparse", "hint": "h"}

    def look(project: Path, _assignments: object) -> ProjectPreview:
        seen = ProjectPreview(8, 10**6, GB)
        time.sleep(0.05)  # the other batch ends it now
        write_json(project / "records/batch.json", theirs)
        return seen

    monkeypatch.setattr(driver, "look_at", look)
    done = batch(root, assignments=["fit.step=0.1"], progress=Listener())
    assert states(done) == {"a": state}
    assert len(pretended.jobs) == (state == "done")
    if state == "crashed":
        assert (done.projects[0].reason, done.projects[0].hint) == ("crashed in sparse", "h")


def test_a_run_of_no_batch_is_waited_for_a_while_and_left(
    tmp_path: Path, pretended: Pretended, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "_AGAIN_SECONDS", 0.01)
    endings, jobs = pretended
    busy = Outcome("busy", 0.1, reason="another run is working on this project")
    endings["a"], endings["b"] = [busy] * 3, [busy] * 99
    done = batch(projects(tmp_path, "a", "b"), progress=Listener())
    assert states(done) == {"a": "done", "b": "busy"}
    assert len([job for job in jobs if job.root.endswith("b")]) == 6


@pytest.mark.parametrize(
    ("look", "state"),
    [(ProjectPreview(8, 0, 0, up_to_date=True), "done"), (ProjectPreview(reason="no photograph"), "failed")],
)
def test_nothing_is_started_for_what_needs_none(
    tmp_path: Path,
    pretended: Pretended,
    monkeypatch: pytest.MonkeyPatch,
    look: ProjectPreview,
    state: str,
) -> None:
    monkeypatch.setattr(driver, "look_at", lambda *_: look)
    assert states(batch(projects(tmp_path, "a"), progress=Listener())) == {"a": state}
    assert not pretended[1]


@pytest.mark.usefixtures("pretended")
def test_a_fault_of_ours_in_one_project_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def look(project: Path, _assignments: object) -> ProjectPreview:
        if project.name == "a":
            raise TypeError("odd")
        return ProjectPreview(8, 10**6, GB)

    monkeypatch.setattr(driver, "look_at", look)
    done = batch(projects(tmp_path, "a", "b"), progress=Listener())
    assert states(done) == {"a": "failed", "b": "done"}
    assert "TypeError: odd" in done.projects[0].reason


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
def test_stopped_by_hand_it_says_so_and_ends_its_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    found = json.loads((root / "batch/batch.json").read_text())
    assert found["state"] == "stopped"
    assert [p["state"] for p in found["projects"]] == ["stopped", "stopped"]
    assert not list((root / "batch").glob("stop-*"))
    assert Entry(root / "a").is_free()


def test_new_projects_run_once_their_files_are_still(
    tmp_path: Path, pretended: Pretended, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_what_a_project_holds_changes_with_its_files(tmp_path: Path) -> None:
    project = Project.at(projects(tmp_path, "a") / "a")
    first, newest = contents_of(project)
    assert abs(newest - time.time()) < 60
    assert contents_of(project)[0] == first
    (project.images / "a.jpg").write_bytes(b"more")
    second = contents_of(project)[0]
    project.options_file.write_text("fit:\n")
    assert len({first, second, contents_of(project)[0]}) == 3


# For real


def make_root(new_project: Callable[..., Path], *names: str) -> Path:
    for name in names:
        root = new_project(name=f"root/{name}").parent
    return root


def crash_in(tmp_path: Path, stage: str, project: str) -> dict[str, str]:
    """An environment in which the run of one project has a real segmentation fault soon after `stage` began."""
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook/sitecustomize.py").write_text(
        "import ctypes, os, sys, threading, time\n"
        "def wait(file):\n"
        "    while not os.path.exists(file): time.sleep(0.002)\n"
        "    time.sleep(0.1)\n"  # it is told just after the file is there
        "    ctypes.string_at(0)\n"
        "said = ' '.join(sys.orig_argv)\n"
        f"if 'job_main' in said and '/{project}\"' in said:\n"
        f"    file = said.split('\"root\": \"')[1].split('\"')[0] + '/records/{stage}.begun.json'\n"
        "    threading.Thread(target=wait, args=(file,), daemon=True).start()\n"
    )
    return {"PYTHONPATH": f"{tmp_path / 'hook'}{os.pathsep}{ROOT}"}


def assert_nothing_half_written(root: Path) -> None:
    left = [
        p
        for p in root.rglob("*")
        if p.suffix == ".tmp" or p.name.endswith(".part.ply") or p.name == "unfinished.db"
    ]
    assert not left


@contextmanager
def command(root: Path, *more: str, env: dict[str, str] | None = None) -> Iterator[subprocess.Popen[str]]:
    """`colmap-ihe batch ROOT` in a process of its own, which does not outlive the test."""
    own = {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-m", "colmap_ihe.cli", "batch", str(root), "--json", *SETTINGS, *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | own | (env or {}),
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def ended(process: subprocess.Popen[str]) -> tuple[int, dict[str, Any], str]:
    output, errors = process.communicate(timeout=400)
    return process.returncode, json.loads(output) if output else {}, errors


def test_one_good_one_broken_one_crashing(new_project: Callable[..., Path], tmp_path: Path) -> None:
    root = make_root(new_project, "crashing", "good")
    (root / "broken/images").mkdir(parents=True)
    (root / "broken/images/a.jpg").write_bytes(b"no photograph")
    assert look_at(root / "good", QUICK).need_bytes > BASE_BYTES
    with command(root, "--no-dense", env=crash_in(tmp_path, "features", "crashing")) as process:
        status, found, errors = ended(process)
    assert status == 1
    by_name = {p["name"]: p for p in found["projects"]}
    assert {name: p["state"] for name, p in by_name.items()} == {
        "broken": "failed",
        "crashing": "crashed",
        "good": "done",
    }
    assert by_name["crashing"]["reason"] == "crashed in features (SIGSEGV)"
    assert "none of the 1 photographs can be used" in by_name["broken"]["reason"]
    assert by_name["good"]["registered_images"] == 8
    assert (root / "batch" / by_name["good"]["page"]).resolve() == root / "good/report/index.html"
    assert "good  begun" in errors and "Traceback" not in errors
    assert look_at(root / "good", [*QUICK, "dense.enabled=false"]).up_to_date
    assert not look_at(root / "good", QUICK).up_to_date


@pytest.mark.slow
def test_six_projects_of_which_two_fail(new_project: Callable[..., Path], tmp_path: Path) -> None:
    """Four succeed and two are explained; the same command then runs what is missing, and nothing else."""
    names = ("a", "b", "crashing", "d", "e")
    root = make_root(new_project, *names)
    broken = root / "broken"
    shutil.copytree(root / "a", broken)
    (broken / "project.yaml").write_text("fit:\n  steps: 1\n")
    with command(root, env=crash_in(tmp_path, "matches", "crashing")) as process:
        status, found, _ = ended(process)
    assert status == 1
    assert found["counts"] == {"done": 4, "crashed": 1, "failed": 1}
    by_name = {p["name"]: p for p in found["projects"]}
    assert by_name["crashing"]["reason"] == "crashed in matches (SIGSEGV)"
    assert "unknown option 'fit.steps'" in by_name["broken"]["reason"]
    assert all(p["hint"] for p in (by_name["crashing"], by_name["broken"]))
    for name in ("a", "b", "d", "e"):
        assert by_name[name]["registered_images"] == 8 and by_name[name]["dense_points"] > 15_000
        assert_nothing_half_written(root / name)
    kept = {p: p.stat().st_mtime_ns for p in root.glob("[abde]/records/*.json")}
    assert len(kept) > 4 * 8

    (broken / "project.yaml").unlink()
    before = (root / "crashing/records/convert.json").stat().st_mtime_ns
    with command(root) as process:
        status, found, _ = ended(process)
    assert status == 0 and found["counts"] == {"done": 6}
    assert kept == {p: p.stat().st_mtime_ns for p in root.glob("[abde]/records/*.json")}
    assert (root / "crashing/records/convert.json").stat().st_mtime_ns == before
    assert_nothing_half_written(root)


def wait_for(file: Path, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 120
    while not file.exists():
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_stopped_or_killed_the_same_command_goes_on(new_project: Callable[..., Path], number: int) -> None:
    root = make_root(new_project, "a", "b", "c")
    with command(root, "--no-dense") as process:
        wait_for(root / "a/records/features.begun.json", process)
        process.send_signal(number)
        status, _, errors = ended(process)
    if number == signal.SIGKILL:
        assert status == -signal.SIGKILL
    else:
        assert status == 130
        assert errors.splitlines()[-1] == "colmap-ihe: stopped; the same command goes on from here"
        assert json.loads((root / "batch/batch.json").read_text())["state"] == "stopped"
        assert not list((root / "batch").glob("stop-*"))
        with Project.at(root / "a").locked():  # its run has ended with it
            pass
    before = (root / "a/records/convert.json").stat().st_mtime_ns
    with command(root, "--no-dense") as process:
        status, found, errors = ended(process)
    assert status == 0, errors
    assert found["counts"] == {"done": 3}
    assert (root / "a/records/convert.json").stat().st_mtime_ns == before
    assert_nothing_half_written(root)


@pytest.mark.slow
def test_two_batches_in_one_folder_share_the_work(new_project: Callable[..., Path]) -> None:
    root = make_root(new_project, "a", "b", "c", "d")
    with (
        command(root, "--no-dense", "--jobs", "1") as one,
        command(root, "--no-dense", "--jobs", "1") as other,
    ):
        results = [ended(one), ended(other)]
    begun = [[line.split()[0] for line in r[2].splitlines() if line.endswith(" begun")] for r in results]
    assert sorted(begun[0] + begun[1]) == ["a", "b", "c", "d"]  # none twice
    assert all(begun)
    with command(root, "--no-dense") as process:
        status, found, errors = ended(process)
    assert (status, found["counts"]) == (0, {"done": 4})
    assert " begun" not in errors


@pytest.mark.slow
def test_projects_run_on_any_executor(new_project: Callable[..., Path]) -> None:
    root = make_root(new_project, "a", "b")
    with ThreadPoolExecutor(1) as executor:
        done = batch(
            root,
            assignments=[*QUICK, "dense.enabled=false"],
            executor=executor,
            progress=Listener(most=300),
        )
    assert done.succeeded and len(done.projects) == 2
    assert all(p.figures["registered_images"] == 8 for p in done.projects)
    assert BASE_BYTES > (done.projects[0].peak_memory_gb or 0) * GB > 0.1 * GB
