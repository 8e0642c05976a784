"""A calibration that a run was given: where its file may lie, and which cameras are held."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from calibrations import calibrated

from colmap_ihe.colmap.calibration_file import write_calibration
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import CalibrationFileError, OptionError
from colmap_ihe.pipeline.given_calibration import given_calibration, held_cameras
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import load_options

GIVEN = "camera.calibration=given.yaml"


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """A project whose database has three cameras."""
    (tmp_path / "images").mkdir()
    project = Project.at(tmp_path)
    project.workspace.mkdir()
    with pycolmap.Database.open(project.database) as database:
        for _ in range(3):
            database.write_camera(pycolmap.Camera.create_from_model_name(0, "PINHOLE", 100, 90, 66))
    return project


def options(*assignments: str) -> Options:
    return load_options(None, assignments)


def started(*camera_ids: int) -> dict[str, Any]:
    """The record of features, with the cameras that start from the file."""
    return {"calibration": {"camera_ids": list(camera_ids)}}


def test_the_file_is_found_from_the_project(project: Project, tmp_path: Path) -> None:
    write_calibration(tmp_path / "given.yaml", [calibrated()])
    assert given_calibration(project, Options()) == []
    assert given_calibration(project, options(GIVEN)) == [calibrated()]
    assert given_calibration(project, options(f"camera.calibration={tmp_path}/given.yaml")) == [calibrated()]
    with pytest.raises(CalibrationFileError, match=r"gone\.yaml: cannot be read"):
        given_calibration(project, options("camera.calibration=gone.yaml"))


def test_the_file_that_each_run_writes_anew_is_refused(project: Project) -> None:
    project.report.mkdir()
    write_calibration(project.report / "calibration.yaml", [calibrated()])
    with pytest.raises(CalibrationFileError, match="lies in report/, which each run writes anew") as caught:
        given_calibration(project, options("camera.calibration=report/calibration.yaml"))
    assert "copy it" in caught.value.hint
    (project.root / "given.yaml").symlink_to(project.report / "calibration.yaml")
    with pytest.raises(CalibrationFileError, match="which each run writes anew"):
        given_calibration(project, options(GIVEN))


def test_which_cameras_are_held(project: Project) -> None:
    known = ("camera.model=SIMPLE_PINHOLE", "camera.params=[90, 45, 33]")
    assert held_cameras(project, options(*known), {}) == frozenset()
    assert held_cameras(project, options(*known, "camera.fixed=true"), {}) == {1, 2, 3}
    assert held_cameras(project, options(GIVEN), started(1, 2)) == frozenset()
    assert held_cameras(project, options(GIVEN, "camera.fixed=true"), started(1, 3)) == {1, 3}


def test_what_cannot_be_held_is_refused(project: Project) -> None:
    fixed = options(GIVEN, "camera.fixed=true", "sparse.mapper=global")
    assert held_cameras(project, fixed, started(1, 2, 3)) == {1, 2, 3}
    with pytest.raises(OptionError, match=r"sparse\.mapper is global") as caught:
        held_cameras(project, fixed, started(1, 2))
    assert "sparse.mapper=incremental" in caught.value.hint
    with pytest.raises(
        CalibrationFileError, match=r"given\.yaml: no camera of it took any of the photographs"
    ):
        held_cameras(project, fixed, started())
