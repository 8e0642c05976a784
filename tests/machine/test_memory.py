"""How many photographs are worked on at a time, by what memory there is."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import psutil
import pytest
from PIL import Image
from told import Told

from colmap_ihe.machine import executor, memory
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs import each as per_image
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import each_usable
from colmap_ihe.photographs.survey import survey
from colmap_ihe.pipeline.fit_files import fit_files
from colmap_ihe.pipeline.warnings import photographs as set_warnings

GB = 10**9


def capture(pixels: int = 0, kind: str = "coded", name: str = "a.jpg") -> Capture:
    return Capture(name, Path(name), "raw" if kind == "raw" else "coded", "a", pixels=pixels)


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine with 8 GB available and no groups; files may be added."""
    monkeypatch.setattr(memory, "_PROC", tmp_path / "proc")
    monkeypatch.setattr(memory, "_CGROUP", tmp_path / "cgroup")
    write(tmp_path / "proc/meminfo", "MemTotal: 16000000 kB\nMemAvailable:    8000000 kB\nSwapFree: 5 kB\n")
    return tmp_path


def write(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="ascii")


@pytest.mark.usefixtures("system")
def test_of_a_machine() -> None:
    assert memory.available() == 8_000_000 * 1024


@pytest.mark.parametrize("where", ["", "user.slice/run.scope"])
def test_of_a_container(system: Path, where: str) -> None:
    """Version 2: the limit may be of a group further up; the file cache in it is given up on demand."""
    write(system / "proc/self/cgroup", "0::/user.slice/run.scope\n")
    write(system / "cgroup/user.slice/run.scope/memory.max", "max\n")
    group = system / "cgroup" / where
    write(group / "memory.max", f"{2 * GB}\n")
    write(group / "memory.current", f"{GB}\n")
    write(group / "memory.stat", "anon 5\ninactive_file 250000000\nfile 9\n")
    assert memory.available() == 1_250_000_000


def test_of_a_container_of_the_first_version(system: Path) -> None:
    write(system / "proc/self/cgroup", "5:cpu,cpuacct:/x\n4:memory:/docker/abc\n")
    group = system / "cgroup/memory/docker/abc"
    write(group / "memory.limit_in_bytes", f"{GB}\n")
    write(group / "memory.usage_in_bytes", "400000000\n")
    write(system / "cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n")
    write(system / "cgroup/memory/memory.usage_in_bytes", "400000000\n")
    assert memory.available() == 600_000_000


def test_where_the_system_does_not_say(system: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (system / "proc/meminfo").unlink()
    assert GB // 10 < memory.available() == pytest.approx(psutil.virtual_memory().available, rel=0.5)
    monkeypatch.setattr(psutil, "virtual_memory", Mock(side_effect=psutil.Error))
    assert memory.available() == 0
    assert memory.at_once([capture(10**9)], 8) == 8


@pytest.mark.usefixtures("system")
def test_the_largest_decides() -> None:
    small, large, raw = capture(10**6), capture(60 * 10**6), capture(60 * 10**6, "raw")
    assert memory.at_once([small] * 100, 8) == 8
    assert memory.at_once([], 8) == memory.at_once([capture()], 8) == 8
    assert 1 < memory.at_once([small, large], 8) < 8
    assert 1 <= memory.at_once([raw, large], 8) < memory.at_once([large], 8)
    assert memory.at_once([capture(500 * 10**6, "raw")], 8) == 1  # rather slowly than not at all


@pytest.mark.usefixtures("system")
def test_it_is_said_in_words() -> None:
    assert memory.in_words([capture(10**8)], 2) == (
        "2 photographs at a time: the largest takes up to 3.0 GB of memory while it is worked on, and 8.2 GB"
        " are free"
    )


def _workers(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    for module in (executor, per_image, set_warnings):
        monkeypatch.setattr(module, "local_workers", lambda: count)


@pytest.mark.parametrize(("pixels", "most"), [(10**6, 4), (70 * 10**6, 2)])
def test_no_more_are_worked_on_than_memory_holds(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, pixels: int, most: int
) -> None:
    _workers(monkeypatch, 4)
    monkeypatch.setattr(memory, "available", lambda: 5 * GB)
    lock, now, peak = threading.Lock(), 0, 0

    def work(_: Capture) -> None:
        nonlocal now, peak
        with lock:
            now += 1
            peak = max(peak, now)
        time.sleep(0.02)
        with lock:
            now -= 1

    captures = [capture(pixels, name=f"{n}.jpg") for n in range(12)]
    with ThreadPoolExecutor(4) as threads, caplog.at_level("INFO", "colmap_ihe"):
        list(each_usable(work, captures, threads, SILENT, False, {}))
    assert peak == most
    assert f"{most} photographs at a time: the largest takes up to" in caplog.text


def test_headers_tell_how_many_pixels(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((80, 100, 3), np.uint8)).save(tmp_path / "a.png")
    with ThreadPoolExecutor(1) as threads:
        found, _ = survey(
            [replace(capture(name="a.png"), path=tmp_path / "a.png")], threads, SILENT, strict=True
        )
    assert found[0].capture.pixels == 8000


def test_the_user_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _workers(monkeypatch, 4)
    Image.fromarray(np.arange(3 * 1000 * 1000, dtype=np.uint32).astype(np.uint8).reshape(1000, 1000, 3)).save(
        tmp_path / "a.png"
    )
    told = Told()
    fit_files([tmp_path], progress=told)
    assert not any("at a time" in text for text in told.warnings)
    monkeypatch.setattr(memory, "available", lambda: 100 * 10**6)
    fit_files([tmp_path], progress=told)
    assert [text for text in told.warnings if "photographs at a time" in text and "there are 4 cores" in text]


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "gnu_get_libc_version"), reason="glibc alone can be told")
def test_pages_are_not_made_anew_for_each_photograph(tmp_path: Path) -> None:
    """Where they are it is a thousand of them."""
    photographs = 12
    for number in range(photographs):
        rgb = np.random.default_rng(number).integers(0, 256, (960, 1280, 3), np.uint8)
        Image.fromarray(rgb).save(tmp_path / f"{number}.jpg")
    code = (
        "import resource, sys; from pathlib import Path;"
        "from colmap_ihe import convert_folder; from colmap_ihe.grey.weights import Weights;"
        "made = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt;"
        "images, out = map(Path, sys.argv[1:]);"
        "done = lambda name: convert_folder(images, out / name, weights=Weights(0, 1, 0));"
        "done('a'); before = made(); done('b'); print(made() - before)"
    )
    command = [sys.executable, "-c", code, str(tmp_path), str(tmp_path.parent / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 300 * photographs


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
