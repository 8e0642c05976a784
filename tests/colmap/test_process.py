"""Processes of our own: what they return and tell, how they are stopped, and what is said when they die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from processes import is_gone, soon
from running import StopsWhen

from colmap_ihe.colmap.native import logged_to, pycolmap
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.errors import Cancelled, NativeError, OptionError
from colmap_ihe.machine import threads
from colmap_ihe.machine.progress import SILENT, Progress


def about(what: str, _progress: Progress) -> Any:
    pycolmap.logging.info(f"asked for {what}")
    return {"pid": os.getpid(), "threads": threads.limit()}[what]


def count(most: int, progress: Progress) -> str:
    for _ in range(most):
        progress.advance(2)
        time.sleep(0.01)
    return "counted"


def keep(file: Path, progress: Progress) -> None:
    file.with_suffix(".begun").touch()
    try:
        while True:
            progress.check()
            time.sleep(0.01)
    finally:
        file.write_text("kept")


def never(file: Path, _progress: Progress) -> None:
    file.touch()
    while True:
        time.sleep(1)


def fail(how: str, _progress: Progress) -> None:
    if how == "known":
        raise OptionError("not an option", hint="leave it out")
    if how == "signal":
        os.kill(os.getpid(), signal.SIGSEGV)
    print("the last words", file=sys.stderr, flush=True)
    os._exit(7)


def unspeakable(_argument: None, _progress: Progress) -> Any:
    return lambda: None


def until(file: Path) -> StopsWhen:
    return StopsWhen(lambda _: file.exists())


def test_a_process_is_kept_for_the_next_call_and_ends_with_the_last() -> None:
    with ColmapProcesses() as apart:
        first = apart.call(about, "pid", SILENT)
        assert first != os.getpid()
        assert apart.call(about, "pid", SILENT) == first
        assert not is_gone(first)
    assert is_gone(first)


def test_calls_take_those_that_were_started_before() -> None:
    with ColmapProcesses() as apart:
        apart.start(2, about)
        started = {process._process.pid for process in apart._idle}
        with ThreadPoolExecutor(2) as two:
            called = {*two.map(lambda _: apart.call(about, "pid", SILENT), range(2))}
        assert len(started) == 2
        assert called <= started
    assert all(map(is_gone, started))


def test_one_for_each_call_at_a_time() -> None:
    with ColmapProcesses() as apart, ThreadPoolExecutor(2) as two:
        watches = [StopsWhen(lambda _: False) for _ in range(2)]
        assert [*two.map(lambda progress: apart.call(count, 20, progress), watches)] == ["counted"] * 2
        assert [progress.done for progress in watches] == [40, 40]
        assert len({*two.map(lambda _: apart.call(about, "pid", SILENT), range(2))}) <= 2


@pytest.mark.parametrize(("asked", "limit", "found"), [(1, None, 1), (None, 3, 3), (None, None, None)])
def test_threads_of_its_own(asked: int | None, limit: int | None, found: int | None) -> None:
    with threads.limited(limit), ColmapProcesses(asked) as apart:
        assert apart.call(about, "threads", SILENT) == found


def test_the_log_is_beside_ours(tmp_path: Path) -> None:
    with logged_to(tmp_path / "colmap.log"), ColmapProcesses() as apart:
        process = apart.call(about, "pid", SILENT)
    (log,) = tmp_path.glob(f"colmap.log.*{process}")
    assert "asked for pid" in log.read_text()


@pytest.mark.parametrize("grace", [0, 0.5])
def test_ended_after_its_grace(tmp_path: Path, grace: float) -> None:
    began = time.monotonic()
    with ColmapProcesses() as apart, pytest.raises(Cancelled):
        apart.call(never, tmp_path / "begun", until(tmp_path / "begun"), grace_seconds=grace)
    assert time.monotonic() - began < 20


def test_what_was_begun_is_finished_within_its_grace(tmp_path: Path) -> None:
    with ColmapProcesses() as apart, pytest.raises(Cancelled):
        apart.call(keep, tmp_path / "a.txt", until(tmp_path / "a.begun"), grace_seconds=60)
    assert (tmp_path / "a.txt").read_text() == "kept"


def test_what_it_raises_is_raised_here() -> None:
    with ColmapProcesses() as apart:
        with pytest.raises(OptionError, match="not an option") as raised:
            apart.call(fail, "known", SILENT)
        assert raised.value.hint == "leave it out"


@pytest.mark.parametrize(
    ("how", "words"), [("signal", "COLMAP died .SIGSEGV."), ("exit", "COLMAP died .the last words.")]
)
def test_one_that_dies_is_told_of_and_another_takes_its_place(how: str, words: str) -> None:
    with ColmapProcesses() as apart:
        with pytest.raises(NativeError, match=words):
            apart.call(fail, how, SILENT)
        assert apart.call(count, 1, SILENT) == "counted"


def test_what_cannot_be_sent_is_an_error_here() -> None:
    with ColmapProcesses() as apart, pytest.raises(Exception, match=r"pickle|local object"):
        apart.call(unspeakable, None, SILENT)


def test_ends_with_us(tmp_path: Path) -> None:
    script = (
        "import os, sys; from pathlib import Path; import test_process as t;"
        " a = t.ColmapProcesses(); print(a.call(t.about, 'pid', t.SILENT), flush=True);"
        " a.call(t.never, Path(sys.argv[1]), t.until(Path('/nowhere')))"
    )
    ours = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path / "begun")],
        stdout=subprocess.PIPE,
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join((str(Path(__file__).parent), *filter(None, sys.path)))},
    )
    assert ours.stdout is not None
    process = int(ours.stdout.readline())
    assert soon((tmp_path / "begun").exists, 30)
    assert not is_gone(process)
    ours.kill()
    ours.wait()
    ours.stdout.close()
    assert soon(lambda: is_gone(process))
