"""What the record of `sparse` says of cameras, and which of them are one whose pictures were turned."""

from __future__ import annotations

from pathlib import Path

import pytest
from grey_noise import noise
from wall_survey import camera, survey

from colmap_ihe.colmap.calibration.calibrate import Calibration
from colmap_ihe.colmap.calibration.deviations import Deviations
from colmap_ihe.colmap.calibration.freedom import Freedom
from colmap_ihe.colmap.calibration.held_out import HeldOut
from colmap_ihe.colmap.part_databases import write_images
from colmap_ihe.pipeline.camera_records import camera_records, turned_cameras
from colmap_ihe.project.folder import Project


@pytest.fixture
def project(tmp_path: Path) -> Project:
    (tmp_path / "images").mkdir()
    return Project.at(tmp_path)


def test_each_camera_with_what_its_parameters_are_from(project: Project) -> None:
    lenses = [camera(camera_id=n) for n in (1, 2, 3)]
    (project.sparse / "0").mkdir(parents=True)
    survey(lenses, 8).write(project.sparse / "0")
    deviations = Deviations((1.5, 0, 0, 0.01), (("f", "k", 0.97),))
    found = Calibration({2: Freedom("SIMPLE_RADIAL", 1)}, {2: deviations}, HeldOut(0.4, 0.3, 5.0), False)
    cameras, held_out = camera_records(project, found, frozenset({3}))
    assert [(c.camera_id, c.photographs, c.by) for c in cameras] == [
        (1, 3, "colmap"),
        (2, 3, "calibration"),
        (3, 2, "given"),
    ]
    assert (cameras[1].names, cameras[1].params) == (["f", "cx", "cy", "k"], [1000, 600, 450, -0.05])
    assert (cameras[1].standard_deviations, cameras[1].correlated) == ([1.5, 0, 0, 0.01], [("f", "k", 0.97)])
    assert cameras[0].standard_deviations is None
    assert held_out is not None
    assert (held_out.colmap_px, held_out.calibrated_px, held_out.standard_errors) == (0.4, 0.3, 5.0)
    assert camera_records(project, None, frozenset())[1] is None


def test_cameras_whose_pictures_were_turned(project: Project) -> None:
    flat, upright = (camera(camera_id=n, size=size) for n, size in ((1, (90, 66)), (2, (66, 90))))
    names = {1: "a.png", 2: "b.png", 3: "c.png"}
    for number, size in ((1, (90, 66)), (2, (90, 66)), (3, (66, 90))):
        noise(project.grey, names[number], size)
    project.database.parent.mkdir(parents=True, exist_ok=True)
    write_images(project.database, {1: flat, 2: flat, 3: upright}, names)
    assert turned_cameras(project, list(names.values())) == [(1, 2)]
    project.database.unlink()
    write_images(project.database, {1: flat, 2: flat}, names)
    assert turned_cameras(project, ["a.png", "b.png"]) == []
