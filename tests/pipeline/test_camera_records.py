"""What the record of `sparse` says of cameras, and which of them are one whose pictures were turned."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from grey_noise import WHOLE, noise
from stage_records import records
from wall_survey import camera, survey

from colmap_ihe.colmap.calibration.calibrate import Calibration
from colmap_ihe.colmap.calibration.deviations import Deviations
from colmap_ihe.colmap.calibration.freedom import Freedom
from colmap_ihe.colmap.calibration.held_out import HeldOut
from colmap_ihe.colmap.part_databases import write_images
from colmap_ihe.pipeline.camera_records import CameraRecord, camera_records, turned_cameras
from colmap_ihe.pipeline.records import is_valid
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


def test_a_record_is_read_back_from_json() -> None:
    """JSON has lists for tuples; what is not the camera of a model counts for none."""
    record = records()["sparse"]
    (camera,) = json.loads(json.dumps(record))["cameras"]
    assert CameraRecord.model_validate(camera).correlated == [("f", "k", 0.97)]
    assert is_valid("sparse", record)
    wrong: list[dict[str, Any]] = [
        {"model": "INVALID"}, {"model": "OPENCV"}, {"names": ["f", "cx", "k", "cy"]}, {"params": [1.0, 2.0]},
        {"standard_deviations": [1.0]}, {"by": "guess"}, {"width": 0}, {"correlated": [["f", "k"]]},
    ]  # fmt: skip
    for changed in wrong:
        assert not is_valid("sparse", record | {"cameras": [camera | changed]}), changed


def test_what_exif_says_of_a_camera_is_there_where_its_photographs_agree(project: Project) -> None:
    lenses = [camera(camera_id=n) for n in (1, 2, 3)]
    (project.sparse / "0").mkdir(parents=True)
    survey(lenses, 6).write(project.sparse / "0")
    for number, lens in ((1, WHOLE), (4, WHOLE), (2, WHOLE), (5, WHOLE | {"focal": 50}), (3, {}), (6, {})):
        noise(project.grey, f"{number:02}.jpg", (90, 66), **lens)
    cameras, _ = camera_records(project, None, frozenset())
    first, second, third = (c.exif for c in cameras)
    assert first is not None and second is None and third is not None
    assert (first.make, first.model, first.focal_length_mm) == ("Foo", "Bar", 35)
    assert (third.make, third.model, third.focal_length_mm) == ("", "", 0)


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
