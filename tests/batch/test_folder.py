"""Which folders are projects of a batch, and where it writes."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from batches import Listener, projects

from colmap_ihe.batch.driver import batch
from colmap_ihe.batch.folder import BatchFolder, contents_of
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import locks
from colmap_ihe.project.folder import Project


def test_projects_are_found_at_any_depth_and_not_in_what_was_made(tmp_path: Path) -> None:
    made = ("b/images/inner", "e/workspace", "made/dense")
    root = projects(tmp_path / "root", "b", "a/deep/c", ".hidden/d", "#recycle/h", "a/@eaDir/i", *made)
    locks.make(root / "e/workspace")
    locks.make(root / "made")
    (root / "f").mkdir()
    (root / "link").symlink_to(tmp_path / "elsewhere")
    projects(tmp_path / "elsewhere", "g")
    (root / "a/loop").symlink_to(root)
    folder = BatchFolder.at(root)
    assert [folder.name_of(p) for p in folder.projects(pytest.fail)] == ["a/deep/c", "b", "link/g"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_folder_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "shut").mkdir(mode=0)
    warnings: list[str] = []
    assert BatchFolder.at(tmp_path).projects(warnings.append) == []
    assert "shut: cannot be read" in warnings[0]


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


def test_what_a_project_holds_changes_with_its_files(tmp_path: Path) -> None:
    project = Project.at(projects(tmp_path, "a") / "a")
    first, newest = contents_of(project)
    assert abs(newest - time.time()) < 60
    assert contents_of(project)[0] == first
    (project.images / "a.jpg").write_bytes(b"more")
    second = contents_of(project)[0]
    project.options_file.write_text("fit:\n")
    assert len({first, second, contents_of(project)[0]}) == 3
