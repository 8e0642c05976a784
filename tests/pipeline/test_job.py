"""One project in a process of its own: however that ends, it is told in words, and nothing is left running."""

from __future__ import annotations

import json
import os
import pickle
import signal
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from unittest.mock import patch

import pytest
from processes import is_gone, soon

from colmap_ihe.errors import BusyError, Cancelled, KnownError, MappingError, NativeError
from colmap_ihe.machine import child_process
from colmap_ihe.pipeline import job, job_main
from colmap_ihe.pipeline.job import Outcome, ProjectJob, StageProgress, run_job
from colmap_ihe.project.folder import Project

TELL = "import json, os, sys, time\ndef tell(**v):\n    print(json.dumps(v), flush=True)\n"
IN_MATCHES = TELL + "tell(stage='matches', done=3, total=9)\n"
ENDED = "tell(ended={'state': 'done', 'reason': '', 'hint': ''})\n"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "church/images").mkdir(parents=True)
    return tmp_path / "church"


@pytest.fixture
def child(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """What runs in place of a reconstruction."""

    def set_to(source: str) -> None:
        monkeypatch.setattr(child_process, "code_of", lambda _module: source)

    return set_to


def ending(project: Path, **more: object) -> Outcome:
    return run_job(ProjectJob(str(project), **more))  # type: ignore[arg-type]


def test_job_and_outcome_go_to_other_machines() -> None:
    sent = ProjectJob("/p", ("fit.step=0.1",), 5.0, 10, "/p/stop")
    assert pickle.loads(pickle.dumps(sent)) == sent
    assert ProjectJob(**{**json.loads(json.dumps(asdict(sent))), "assignments": sent.assignments}) == sent
    assert pickle.loads(pickle.dumps(Outcome("done", 1.0))) == Outcome("done", 1.0)
    assert pickle.loads(pickle.dumps(run_job)) is run_job


def test_it_is_followed_and_what_is_printed_goes_to_the_log(
    project: Path, child: Callable[[str], None]
) -> None:
    child(IN_MATCHES + "print('words', file=sys.stderr); time.sleep(0.6)\n" + ENDED)
    seen: list[StageProgress] = []
    outcome = run_job(ProjectJob(str(project)), seen.append)
    assert (outcome.state, outcome.stage, outcome.reason) == ("done", "", "")
    assert 0.5 < outcome.seconds < 30
    assert 5_000_000 < outcome.peak_bytes < 500_000_000
    assert any(p.stage == "matches" and (p.done, p.total) == (3, 9) and p.bytes > 0 for p in seen)
    assert (project / "records/batch.log").read_text() == "words\n"


@pytest.mark.parametrize(
    ("source", "state", "reason"),
    [
        ("import ctypes; ctypes.string_at(0)", "crashed", "crashed in matches (SIGSEGV)"),
        ("os.abort()", "crashed", "crashed in matches (SIGABRT)"),
        ("os.write(2, b'std::bad_alloc'); os.abort()", "out_of_memory", "memory ran out in matches"),
        ("os.kill(os.getpid(), 9)", "out_of_memory", "killed by the system in matches, as it does when"),
        ("os.kill(os.getpid(), 15)", "stopped", "stopped from elsewhere in matches (SIGTERM)"),
        ("raise RuntimeError('odd')", "crashed", "exit status 1: RuntimeError: odd"),
        ("os._exit(3)", "crashed", "ended without a result in matches, exit status 3: it said nothing"),
    ],
)
def test_a_crash_is_told_in_words(
    project: Path, child: Callable[[str], None], source: str, state: str, reason: str
) -> None:
    child(IN_MATCHES + source)
    outcome = ending(project)
    assert outcome.state == state
    assert reason in outcome.reason
    assert outcome.stage == "matches"
    assert "goes on from there" in outcome.hint


def test_the_time_limit_ends_it_cleanly(project: Path, child: Callable[[str], None]) -> None:
    child(IN_MATCHES + "sys.stdin.read()\ntell(ended={'state': 'stopped', 'reason': 'r', 'hint': 'h'})\n")
    outcome = ending(project, time_limit_s=0.4)
    assert outcome.state == "timed_out"
    assert "time limit of 0.006667 min in matches" in outcome.reason
    assert outcome.seconds < 20


def test_one_that_does_not_listen_is_killed_with_all_it_started(
    project: Path, child: Callable[[str], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(job, "GRACE_SECONDS", 0.3)
    note = tmp_path / "pid"
    started = "import subprocess; p = subprocess.Popen(['sleep', '99'])\n"
    child(IN_MATCHES + started + f"open({str(note)!r}, 'w').write(str(p.pid)); time.sleep(99)")
    outcome = ending(project, time_limit_s=1.0)
    assert outcome.state == "timed_out"
    assert outcome.seconds < 20
    assert soon(lambda: is_gone(int(note.read_text())))


def test_a_file_stops_it(project: Path, child: Callable[[str], None], tmp_path: Path) -> None:
    child(IN_MATCHES + f"open({str(tmp_path / 'stop')!r}, 'w').close()\nsys.stdin.read()\n")
    outcome = ending(project, stop_file=str(tmp_path / "stop"))
    assert (outcome.state, outcome.reason) == ("stopped", "stopped in matches")


def test_what_is_no_project_is_a_failure(tmp_path: Path) -> None:
    outcome = ending(tmp_path / "nowhere")
    assert outcome.state == "failed"
    assert "no such folder of photographs" in outcome.reason and outcome.hint


@pytest.mark.parametrize(
    ("error", "state", "reason"),
    [
        (MappingError("no two match", hint="overlap"), "failed", "no two match"),
        (NativeError("COLMAP failed: std::bad_alloc"), "out_of_memory", "std::bad_alloc"),
        (MemoryError(), "out_of_memory", "memory ran out"),
        (BusyError("another run"), "busy", "another run"),
        (Cancelled(), "stopped", "stopped"),
        (OSError(5, "Input/output error", "/a/b.jpg"), "failed", "/a/b.jpg: Input/output error"),
        (TypeError("odd"), "crashed", "an error that we did not expect: TypeError: odd"),
    ],
)
def test_errors_of_a_run_are_told(
    project: Path, error: BaseException, state: str, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    teller = job_main._Teller(os.dup(1))
    with patch.object(job_main, "reconstruct", side_effect=error), teller._out:
        found = job_main._run(asdict(ProjectJob(str(project))), teller)
    assert found[0] == state
    assert reason in found[1]
    if isinstance(error, KnownError):
        assert found[2] == error.hint or state == "out_of_memory"
    assert ("Traceback" in capfd.readouterr().err) == isinstance(error, TypeError)


def test_without_its_parent_it_stops(new_project: Callable[..., Path]) -> None:
    """As a killed batch leaves it: stdin closes, and the run ends by itself and says where."""
    project = new_project()
    seen: list[StageProgress] = []

    def follow(progress: StageProgress) -> None:
        seen.append(progress)
        if progress.stage in ("fit", "convert", "features") and not stopped.exists():
            stopped.touch()

    stopped = project / "stop"
    outcome = run_job(ProjectJob(str(project), stop_file=str(stopped)), follow)
    assert outcome.state == "stopped"
    assert outcome.stage and outcome.stage != "page"
    with Project.at(project).locked():  # nobody has it any more
        pass
    assert not (project / "records/mesh.json").exists()


def test_signals_have_names() -> None:
    assert child_process.crash_of(-signal.SIGBUS) == "SIGBUS"
    assert child_process.crash_of(-99) == "signal 99"
    assert sys.platform != "linux" or child_process.crash_of(-11) == "SIGSEGV"
    assert child_process.crash_of(0xC0000005) == "access violation"  # of Windows
    assert [child_process.crash_of(status) for status in (None, 0, 1, 3)] == [""] * 4
