"""A run within limits of the system: slower or refused in one line, not killed; and what it holds stays bounded."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import simplejpeg
from command_line import ENVIRONMENT, failure_of
from processes import children
from same_results import contents
from small_demo import SETTINGS, Make, MakeOptions

from colmap_ihe.cli import main
from colmap_ihe.errors import DiskFullError, NativeError, ShortOfMemoryError
from colmap_ihe.machine import memory
from colmap_ihe.pipeline.estimates import bytes_on_disk, disk_left, disk_warnings, memory_warnings, needs_of
from colmap_ihe.pipeline.output_folder import opened
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.resource_needs import PhotoSetSize, StageNeeds
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

GB = 10**9
SET = PhotoSetSize(100, pixels=2 * GB, largest=20_000_000, raw=0, with_gps=0, one_bytes=600_000_000)

# Memory


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """8 GB, and no group; this process uses 1 GB of addresses and 0.3 of data."""
    proc = tmp_path / "proc"
    (proc / "self").mkdir(parents=True)
    (proc / "meminfo").write_text("MemAvailable: 8000000 kB\n")
    (proc / "self/status").write_text("VmSize:\t 1000000 kB\nVmRSS:\t 200000 kB\nVmData:\t 300000 kB\n")
    monkeypatch.setattr(memory, "_PROC", proc)
    return proc


@pytest.mark.posix
@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize(("kind", "used"), [(resource.RLIMIT_AS, 1_000_000), (resource.RLIMIT_DATA, 300_000)])
def test_limits_of_the_process_count(monkeypatch: pytest.MonkeyPatch, kind: int, used: int) -> None:
    limits = {kind: 3 * GB}
    most = resource.RLIM_INFINITY
    monkeypatch.setattr(resource, "getrlimit", lambda one: (limits.get(one, most), most))
    assert 0.8 * (3 * GB - used * 1024) < memory.available() < 3 * GB - used * 1024
    limits[kind] = 10**6
    assert memory.available() == 1
    del limits[kind]
    assert memory.available() == 8_000_000 * 1024


@pytest.mark.usefixtures("machine")
def test_fewer_threads_are_told_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "colmap_ihe"):
        assert memory.workers_for("features", GB, 16) == 7
        assert memory.workers_for("features", 20 * GB, 16) == 1
        assert memory.workers_for("matches", 10**6, 16) == 16
    assert [record.message for record in caplog.records] == [
        "features: 7 of 16 threads, for each takes up to 1.0 GB of memory and 8.2 GB are free",
        "features: 1 of 16 threads, for each takes up to 20.0 GB of memory and 8.2 GB are free",
    ]


def test_memory_that_ran_out_is_one_line() -> None:
    short = OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)), RuntimeError("can't start new thread")
    words = "features: memory ran out"
    for error in (*short, MemoryError(), NativeError("COLMAP failed: std::bad_alloc")):
        with pytest.raises(ShortOfMemoryError, match=words) as caught, memory.said_when_short("features"):
            raise error
        assert "the same command goes on" in caught.value.hint
    with pytest.raises(LookupError), memory.said_when_short("features"):
        raise LookupError("something else")


def test_one_worker_that_may_find_too_little_is_told_before(monkeypatch: pytest.MonkeyPatch) -> None:
    features = next(one for one in needs_of(Options(), SET) if one.stage == "features")
    assert features.one_bytes > GB
    monkeypatch.setattr(memory, "available", lambda: 20 * GB)
    assert memory_warnings(features) == []
    monkeypatch.setattr(memory, "available", lambda: GB)
    (said,) = memory_warnings(features)
    assert said.startswith("features takes up to ")
    assert "features.max_image_size" in said
    smaller = needs_of(Options.model_validate({"features": {"max_image_size": 500}}), SET)
    assert memory_warnings(next(one for one in smaller if one.stage == "features")) == []


LIMITED = (
    "import os, resource, sys; resource.setrlimit(int(sys.argv[1]), (int(sys.argv[2]),) * 2);"
    " os.execv(sys.executable, [sys.executable, '-m', 'colmap_ihe.cli', *sys.argv[3:]])"
)


def _limited(project: Path, kind: int, most: int, *more: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", LIMITED, str(kind), str(most), "reconstruct", str(project), "--json"]
    command += ["--verbose", *SETTINGS, *more]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=ENVIRONMENT)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "most"), [(resource.RLIMIT_AS, 1_400_000_000), (resource.RLIMIT_DATA, 1_000_000_000)]
)
def test_a_run_within_a_limit_of_the_system(new_project: Make, kind: int, most: int) -> None:
    """`ulimit -v` and `ulimit -d`, with room for little more than one worker: fewer, and as good."""
    project = new_project()
    ended = _limited(project, kind, most, "--until", "dense", "--no-mesh")
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert json.loads(ended.stdout)["registered_images"] == 8


@pytest.mark.slow
def test_a_limit_that_is_too_low_is_told_before_the_stage(new_project: Make) -> None:
    ended = _limited(new_project(), resource.RLIMIT_AS, 900_000_000, "--until", "fit")
    assert "fit takes up to" in ended.stderr
    assert "Traceback" not in ended.stderr


# Disk


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    usage = SimpleNamespace(free=10**12)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    return usage


@pytest.mark.parametrize(
    ("change", "grows"),
    [
        (
            {"images": 200, "pixels": 4_000_000_000},
            ("convert", "features", "matches", "sparse", "dense", "drawings"),
        ),
        ({"raw": 100}, ("convert",)),
    ],
)
def test_larger_sets_want_more(change: dict[str, int], grows: Sequence[str]) -> None:
    few, many = needs_of(Options(), SET), needs_of(Options(), replace(SET, **change))
    more = [one.stage for one, other in zip(few, many, strict=True) if other.disk_bytes > one.disk_bytes]
    assert more == list(grows)


def test_what_is_switched_off_wants_nothing() -> None:
    names = [one.stage for one in needs_of(Options.model_validate({"dense": {"enabled": False}}), SET)]
    assert names == ["captures", "fit", "convert", "features", "matches", "sparse", "survey", "page"]


def test_a_project_takes_what_was_estimated(finished: Path, quick_options: MakeOptions) -> None:
    """Within a factor, stage by stage; the small demo is all noise and edges, and its page as large as any."""
    place, record = Project.at(finished), json.loads((finished / "records/captures.json").read_text())
    found = {one.stage: one for one in needs_of(quick_options(), PhotoSetSize.of(record, []))}
    taken = bytes_on_disk(place)
    assert taken["convert"] < found["convert"].disk_bytes < 2 * taken["convert"]
    assert taken["dense"] < found["dense"].disk_bytes < 2 * taken["dense"]
    assert sum(taken.values()) < sum(one.disk_bytes for one in found.values()) < 2 * sum(taken.values())


def test_what_is_there_already_is_not_wanted_again(finished: Path) -> None:
    place = Project.at(finished)
    there = bytes_on_disk(place)["dense"]
    assert there > 10**6
    wanted = [StageNeeds("convert", 0, 0, 1), StageNeeds("dense", 0, 0, there + 1000)]
    assert disk_left(place, wanted, ["convert", "dense", "mesh"]) == {"convert": 0, "dense": 1000}
    assert disk_left(place, wanted, ["mesh"]) == {}


def test_a_disk_that_is_close_or_too_small(tmp_path: Path, disk: SimpleNamespace) -> None:
    (tmp_path / "images").mkdir()
    place, wanted = Project.at(tmp_path), [StageNeeds("convert", 0, 0, GB), StageNeeds("dense", 0, 0, 4 * GB)]
    stages = ["convert", "dense"]
    assert disk_warnings(place, wanted, stages) == []
    disk.free = 5 * GB
    (said,) = disk_warnings(place, wanted, stages)
    needed = "5.0 GB free on this disk, about 5.0 GB needed (dense 4.0 GB, convert 1.0 GB)"
    assert said.startswith(f"{tmp_path}: {needed}")
    disk.free = 3 * GB
    with pytest.raises(DiskFullError, match=r"3\.0 GB free on this disk, about 5\.0 GB needed"):
        disk_warnings(place, wanted, stages)
    assert disk_warnings(place, wanted, ["convert"]) == []


def test_a_run_is_refused_before_it_writes_and_goes_on_where_there_is_room(
    new_project: Make, quick_options: MakeOptions, disk: SimpleNamespace
) -> None:
    project, options = new_project(3), quick_options("fit.measure=false")
    disk.free = 10**5
    with pytest.raises(DiskFullError, match="free on this disk, about"):
        reconstruct(project, options, until="convert")
    assert not (project / "workspace/images").exists()
    disk.free = 10**12
    assert reconstruct(project, options, until="convert").stages_run == ("fit", "convert")
    disk.free = 10**5
    assert reconstruct(project, options, until="convert").stages_run == ()  # nothing is left to be written


# Open files and threads


def photographs(folder: Path, count: int) -> None:
    folder.mkdir(parents=True)
    chance = np.random.default_rng(0)
    blocks = chance.integers(0, 256, (6, 8, 3), np.uint8)
    for number in range(count):
        pixels = np.roll(blocks, number, axis=1).repeat(12, axis=0).repeat(12, axis=1)
        jpeg = simplejpeg.encode_jpeg(np.ascontiguousarray(pixels), quality=80)
        (folder / f"{number:04}.jpg").write_bytes(jpeg)


def of_process(process: int) -> tuple[int, int]:
    """Open files and threads; none of one that has ended."""
    try:
        return tuple(len(list(Path(f"/proc/{process}/{what}").iterdir())) for what in ("fd", "task"))  # type: ignore[return-value]
    except OSError:
        return 0, 0


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_open_files_threads_and_processes_do_not_grow_with_the_set(tmp_path: Path, count: int) -> None:
    """With few open files allowed; each photograph that left one open would end the run half-way."""
    photographs(tmp_path / "project/images", count)
    command = [sys.executable, "-c", LIMITED, str(resource.RLIMIT_NOFILE), "48"]
    command += ["reconstruct", str(tmp_path / "project"), "--quiet", "--until", "features"]
    command += ["--set", "fit.measure=false", "--set", "fit.step=0.1"]
    files = threads = processes = 0
    with subprocess.Popen(command, stderr=subprocess.PIPE, env=ENVIRONMENT) as process:
        assert process.stderr is not None
        while process.poll() is None:
            everyone = [process.pid, *children(process.pid)]
            processes = max(processes, len(everyone))
            for one in everyone:
                now = of_process(one)
                files, threads = max(files, now[0]), max(threads, now[1])
            try:
                process.wait(0.05)
            except subprocess.TimeoutExpired:
                continue
        errors = process.stderr.read().decode()
    assert process.returncode == 0, errors
    record = json.loads((tmp_path / "project/records/features.json").read_text())
    assert record["images"] == count and not record["left_out"]
    workers = len(os.sched_getaffinity(0))
    print(f"{count} photographs: {files} open files, {threads} threads, {processes} processes at the most")
    assert 5 < files < 48
    assert 1 < threads < 20 + 4 * workers
    assert 1 < processes < 4 + 2 * workers


# Who is at it


@pytest.fixture
def read_only() -> Iterator[Callable[[Path], None]]:
    """Makes a folder read-only: for root, who may write everywhere, by mounting it so."""
    mounted: list[Path] = []

    def make(folder: Path) -> None:
        if os.getuid():
            folder.chmod(0o555)
            return
        for options in ("bind", "remount,bind,ro"):
            command = ["mount", "-o", options, str(folder), str(folder)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                pytest.skip(f"a folder cannot be mounted read-only: {done.stderr.strip()}")
            mounted.append(folder)

    yield make
    for folder in dict.fromkeys(mounted):
        subprocess.run(["umount", "-l", str(folder)], check=True)


def test_photographs_are_never_written_to(
    new_project: Make, quick_options: MakeOptions, read_only: Callable[[Path], None]
) -> None:
    project = new_project(3, (".jpg", ".dng"))
    images = project / "images"
    before = contents(images), {f.name: f.stat().st_mtime_ns for f in images.iterdir()}
    read_only(images)
    done = reconstruct(project, quick_options("dense.enabled=false"))
    assert done.summary["images"] == 3
    assert (contents(images), {f.name: f.stat().st_mtime_ns for f in images.iterdir()}) == before


@pytest.mark.parametrize("command", ["reconstruct", "compare", "report"])
def test_a_project_that_may_not_be_written_to_is_one_line(
    finished: Path, read_only: Callable[[Path], None], capsys: pytest.CaptureFixture[str], command: str
) -> None:
    read_only(finished)
    assert main([command, str(finished), "--quiet"]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "not writable" in line and "give write permission, or use another folder" in line


@pytest.mark.parametrize(
    ("command", "held", "more"),
    [("reconstruct", "", SETTINGS), ("report", "", SETTINGS), ("compare", "compare", ["--methods", "green"])],
)
def test_the_second_on_one_project_says_so_and_leaves(
    finished: Path, capsys: pytest.CaptureFixture[str], command: str, held: str, more: Sequence[str]
) -> None:
    with Project.at(finished / held, finished / "images").locked():
        line = failure_of(capsys, command, finished, *more)
    assert "another run is working on this project" in line and "wait for it, or stop it" in line


@pytest.mark.parametrize("command", ["convert", "develop"])
def test_a_second_one_into_one_folder_says_so_and_leaves(
    small_demo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    images = tmp_path / "images"
    images.mkdir()
    shutil.copy(small_demo / "images/portico_01.dng", images)
    with opened(tmp_path / "out"):
        line = failure_of(capsys, command, images, tmp_path / "out")
    assert "another run is writing into it" in line and "wait for it, or stop it" in line
