"""Temporary files go with their process, however that ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from unittest.mock import patch

import pytest

from colmap_ihe.errors import DiskFullError
from colmap_ihe.machine.files import remove_unfinished, write_bytes
from colmap_ihe.machine.scratch import scratch_folder, sweep
from colmap_ihe.pipeline import outputs
from colmap_ihe.project.folder import Project

LIVES = """
import sys, time
from colmap_ihe.machine.scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "half").write_bytes(b"half")
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return tmp_path / "tmp"


def left_in(temporary: Path) -> set[str]:
    """Names of what is there, but for files by which folders are locked: those Windows removes by itself."""
    return {file.name for file in temporary.iterdir() if not file.name.startswith("colmap-ihe-lock-")}


def test_it_is_gone_after_success_and_after_failure(temporary: Path) -> None:
    with scratch_folder() as folder:
        assert folder.parent == temporary
        (folder / "deep").mkdir()
    with pytest.raises(KeyError), scratch_folder():
        raise KeyError
    assert not left_in(temporary)


def test_of_a_killed_process_it_goes_at_the_next_start_and_of_a_live_one_it_stays(temporary: Path) -> None:
    (temporary / "colmap-ihe-scratch-of-theirs").write_text("no folder")
    (temporary / "colmap-ihe-else").mkdir()
    command = [sys.executable, "-c", LIVES]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        theirs = Path(process.stdout.readline().strip())
        sweep()
        with scratch_folder() as ours:
            assert theirs.is_dir() and ours.is_dir()
        assert (theirs / "half").exists()
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert theirs.is_dir()
    with scratch_folder():
        assert not theirs.exists()
    assert left_in(temporary) == {"colmap-ihe-scratch-of-theirs", "colmap-ihe-else"}


@pytest.mark.usefixtures("temporary")
def test_one_that_was_swept_before_it_was_locked_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    make, made = tempfile.mkdtemp, []

    def swept(prefix: str) -> str:
        made.append(make(prefix=prefix))
        if len(made) == 1:
            sweep()
        return made[-1]

    monkeypatch.setattr(tempfile, "mkdtemp", swept)
    with scratch_folder() as folder:
        assert folder.is_dir()
    assert len(made) == 2


def test_without_a_folder_for_temporary_files(temporary: Path) -> None:
    temporary.rmdir()
    tempfile.tempdir = str(temporary)
    with pytest.raises(DiskFullError, match="no such folder") as caught, scratch_folder():
        pass
    assert "TMPDIR" in caught.value.hint


def test_half_written_files_of_a_killed_run_go_and_others_stay(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    project = Project.at(tmp_path)
    left = [
        project.dense / "images/.0123456789abcdef01234567.0a1b2c3d.tmp",
        project.records / ".0123456789abcdef01234567.99999999.tmp",
        project.dense / "fused.part.ply.rows",
        project.dense / "mesh.poisson.part.ply",
        project.dense / "stereo/.cell/fused.ply",
        project.workspace / ".sparse.old/0/cameras.bin",
        project.workspace / "vocabulary.bin",
    ]
    kept = [project.dense / "fused.ply", project.grey / "a.png", project.database]
    kept.append(project.workspace / ".mine.tmp")
    for file in (*left, *kept, project.images / "a.jpg"):
        write_bytes(file, b"x")
    outputs.remove_unfinished(project)
    assert not [file for file in left if file.exists()]
    assert all(file.exists() for file in kept) and (project.images / "a.jpg").exists()
    assert not (project.workspace / ".sparse.old").exists()


def test_the_names_that_write_bytes_gives_are_those_that_are_removed(tmp_path: Path) -> None:
    """Killed before the rename: nothing after it runs, and the old file is whole."""
    write_bytes(tmp_path / "a.png", b"old")
    with patch.object(Path, "replace", side_effect=SystemExit), patch.object(Path, "unlink"):
        for _ in range(20):  # names are of chance
            with pytest.raises(SystemExit):
                write_bytes(tmp_path / "a.png", b"half")
    assert len(list(tmp_path.iterdir())) == 21
    remove_unfinished(tmp_path)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"old"]
