"""Clocks that jump decide nothing, and a disk that goes costs nothing: one line, and the same command goes on."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from small_demo import Make, MakeOptions

from colmap_ihe.errors import KnownError, ProjectError
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.files import (
    digest_file,
    guard_folder,
    room_on_disk,
    write_bytes,
    write_json,
)
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.photographs.discover import discover
from colmap_ihe.pipeline.input_digests import digests_of
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.stage import RunContext, StageRecord
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


@pytest.fixture
def quick(quick_options: MakeOptions) -> Options:
    return quick_options("fit.measure=false")


@pytest.fixture
def place(tmp_path: Path) -> Project:
    (tmp_path / "images").mkdir()
    for name in ("a.jpg", "b.jpg"):
        (tmp_path / "images" / name).write_bytes(name.encode() * 9)
    return Project.at(tmp_path)


def read_again(place: Project, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The photographs whose content is read, where all were looked at before."""
    read: list[str] = []
    whole = digest_file

    def digest(path: Path) -> str:
        read.append(path.name)
        return whole(path)

    with monkeypatch.context() as patched, local_executor() as threads:
        patched.setattr("colmap_ihe.pipeline.input_digests.digest_file", digest)
        write_json(place.digests_file, digests_of(place, discover(place.images), threads, SILENT))
    return sorted(read)


def later(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    now = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: now() + int(seconds * 1e9))


def test_the_same_size_and_time_with_another_content(place: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that sets the old time, or a clock that was set back: the time that no program can set tells."""
    later(monkeypatch, 60)
    assert read_again(place, monkeypatch) == ["a.jpg", "b.jpg"]
    assert read_again(place, monkeypatch) == []
    file = place.images / "a.jpg"
    before = file.stat()
    file.write_bytes(b"y" * before.st_size)
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (file.stat().st_size, file.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    assert read_again(place, monkeypatch) == ["a.jpg"]


def test_a_photograph_of_the_future_is_no_matter(place: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera's clock was wrong; the copy kept its time."""
    later(monkeypatch, 60)
    for file in place.images.iterdir():
        os.utime(file, (4e9, 4e9))
    read_again(place, monkeypatch)
    assert read_again(place, monkeypatch) == []


@pytest.mark.parametrize("jump_s", [0, -3600], ids=["just now", "the clock was set back"])
def test_a_change_that_its_time_could_hide_is_looked_for(
    place: Project, monkeypatch: pytest.MonkeyPatch, jump_s: float
) -> None:
    """Read right after it was written, by a clock that counts in steps, or before it was written."""
    later(monkeypatch, jump_s)
    read_again(place, monkeypatch)
    assert read_again(place, monkeypatch) == ["a.jpg", "b.jpg"]


def test_digests_of_an_earlier_version_are_read_again(
    place: Project, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = (place.images / "a.jpg").stat()
    write_json(place.digests_file, {"a.jpg": [about.st_size, about.st_mtime_ns, "old"], "b.jpg": ["odd"]})
    assert read_again(place, monkeypatch) == ["a.jpg", "b.jpg"]


# Disks


def test_nothing_is_written_below_a_mount_point_whose_disk_went(tmp_path: Path) -> None:
    project = tmp_path / "project"
    project.mkdir()
    with pytest.raises(ProjectError, match="the folder is gone") as caught, guard_folder(project):
        write_bytes(project / "records/a.json", b"{}")
        project.rename(tmp_path / "elsewhere")
        write_bytes(project / "records/b.json", b"{}")
    assert not project.exists()
    assert "the same command goes on" in caught.value.hint
    elsewhere = tmp_path / "elsewhere"
    with pytest.raises(ProjectError, match="another one is in its place"), guard_folder(elsewhere):
        shutil.move(elsewhere, project)
        elsewhere.mkdir()
        raise KeyError("what came of it")
    with guard_folder(project):
        write_bytes(project / "records/b.json", b"{}")


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE, errno.ENOTCONN])
def test_a_disk_that_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def fails(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(ProjectError, match="does not answer") as caught, room_on_disk(tmp_path):
        write_bytes(tmp_path / "a.json", b"{}")
    assert "the same command goes on" in caught.value.hint
    assert not list(tmp_path.iterdir())


def _after(monkeypatch: pytest.MonkeyPatch, stage: str, do: Callable[[RunContext], object]) -> None:
    """Does something in the middle of a stage, once."""
    whole, did = next(one.run for one in STAGES if one.name == stage), [False]

    def and_then(run: RunContext, progress: Progress) -> StageRecord:
        if not did[0]:
            did[0] = True
            do(run)
        return whole(run, progress)

    stages = tuple(replace(one, run=and_then) if one.name == stage else one for one in STAGES)
    for module in ("reconstruct", "run_stages"):
        monkeypatch.setattr(f"colmap_ihe.pipeline.{module}.STAGES", stages)


def test_a_project_that_goes_in_the_middle(
    new_project: Make, quick: Options, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project, away = new_project(3), tmp_path / "away"
    _after(monkeypatch, "fit", lambda _: project.rename(away))
    with pytest.raises(ProjectError, match="the folder is gone"):
        reconstruct(project, quick, until="convert")
    assert not project.exists()
    away.rename(project)
    done = reconstruct(project, quick, until="convert")
    assert done.stages_run == ("fit", "convert")
    assert done.summary["images"] == 3


def _mount(*words: str) -> None:
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no mount command")
    if done.returncode:
        pytest.skip(f"a disk cannot be mounted: {done.stderr.strip()}")


def test_a_disk_that_is_unmounted_in_the_middle(
    new_project: Make, quick: Options, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its mount point stays, and is a folder like any other: of the disk below."""
    disk, project = new_project(3), tmp_path / "mounted"
    project.mkdir()
    _mount("mount", "--bind", str(disk), str(project))
    try:
        _after(monkeypatch, "convert", lambda _: subprocess.run(["umount", "-l", project], check=True))
        with pytest.raises(KnownError, match="the folder is gone, or another one is in its place"):
            reconstruct(project, quick, until="convert")
        assert not list(project.iterdir())
        _mount("mount", "--bind", str(disk), str(project))
        assert reconstruct(project, quick, until="convert").stages_run == ("convert",)
    finally:
        subprocess.run(["umount", "-l", project], check=False, capture_output=True)


@pytest.mark.parametrize("stage", ["fit", "convert"])
def test_photographs_that_go_in_the_middle_do_not_make_a_smaller_set(
    new_project: Make, quick: Options, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    project, away = new_project(3), tmp_path / "away"
    images = project / "images"
    _after(monkeypatch, stage, lambda _: images.rename(away))
    with pytest.raises(KnownError, match="was there when the run began"):
        reconstruct(project, quick, until="convert")
    with pytest.raises(ProjectError, match="no such folder of photographs"):
        reconstruct(project, quick, until="convert")
    away.rename(images)
    done = reconstruct(project, quick, until="convert")
    assert not done.summary["left_out"]
    assert len(list((project / "workspace/images").iterdir())) == 3


def test_a_photograph_that_cannot_be_read_for_a_while_is_not_left_out(
    new_project: Make, quick: Options, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is there, and reading it fails: a network folder in trouble. What it held is known from before."""
    project = new_project(3)
    file = project / "images/portico_02.jpg"
    whole = file.read_bytes()
    _after(monkeypatch, "fit", lambda _: file.write_bytes(whole[:500]))
    with pytest.raises(ProjectError, match="changed while it was worked on, or its disk went"):
        reconstruct(project, quick, until="convert")
    file.write_bytes(whole)
    assert not reconstruct(project, quick, until="convert").summary["left_out"]
