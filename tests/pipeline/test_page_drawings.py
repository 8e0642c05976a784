"""Drawings on the page of a project, also where somebody changed them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyproj
import pytest
from PIL import Image

from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.choose import DrawnModel
from colmap_ihe.pipeline.drawings import BY_COMMAND, BY_RUN, folders_made_by, setting_of
from colmap_ihe.pipeline.page_drawings import drawings_of
from colmap_ihe.project.folder import Project
from colmap_ihe.report.contents import FileLink
from colmap_ihe.survey.frames import GPS, Frame

ABOUT = {
    "kind": "facade", "made_by": "reconstruct", "metric": True, "scale": 50, "papers": ["A3", "A3"], "pixel": 0.005,
    "pixel_mm": 5.0, "holes_percent": 9.76, "without_photograph_percent": 1.0, "deviation_range": 0.05,
    "files": ["orthophoto.tif", "sheets.pdf"],
}  # fmt: skip


def project_with(root: Path, **drawings: object) -> Project:
    (root / "images").mkdir()
    for name, about in drawings.items():
        (root / "drawings" / name).mkdir(parents=True)
        (root / "drawings" / name / "drawing.json").write_text(json.dumps(about))
        Image.fromarray(np.zeros((30, 40, 3), np.uint8)).save(root / "drawings" / name / "preview.jpg")
    (root / "drawings/.made-by-colmap-ihe").touch()
    return Project.at(root)


def test_a_drawing_has_its_picture_facts_and_files(tmp_path: Path) -> None:
    (drawing,) = drawings_of(project_with(tmp_path, **{"north side": ABOUT}))
    assert drawing.name == "north side"
    assert [(p.width, p.height, p.alt) for p in drawing.pictures] == [
        (40, 30, "north side: orthophoto, façade")
    ]
    assert dict(drawing.facts) == {
        "sheets": "1:50, A3, A3", "a pixel": "5 mm", "without a surface": "9.8 %", "not in photographs": "1.0 %",
    }  # fmt: skip
    assert drawing.files[0] == FileLink("sheets (PDF)", "../drawings/north%20side/sheets.pdf")


def test_one_that_is_not_metric_gives_no_scale(tmp_path: Path) -> None:
    (drawing,) = drawings_of(project_with(tmp_path, front=ABOUT | {"metric": False, "pixel_mm": None}))
    assert drawing.facts[0] == ("sheets", "not to scale: the model is not metric, A3, A3")


def test_what_somebody_changed_is_left_out(tmp_path: Path) -> None:
    project = project_with(
        tmp_path,
        a=ABOUT | {"kind": "<b>"},
        b=[],
        c=ABOUT | {"files": 7},
        d=ABOUT | {"papers": 7},
        e=ABOUT | {"kind": []},
    )
    (tmp_path / "drawings/d/preview.jpg").write_bytes(b"no picture")
    (drawing,) = drawings_of(project)
    assert (drawing.name, drawing.pictures, drawing.facts[0]) == ("d", [], ("sheets", "1:50"))


def test_a_folder_of_the_users_own_holds_no_drawings(tmp_path: Path) -> None:
    project = project_with(tmp_path, front=ABOUT, back=ABOUT | {"made_by": "draw"})
    assert [f.name for f in folders_made_by(project, BY_RUN)] == ["front"]
    assert [f.name for f in folders_made_by(project, BY_COMMAND)] == ["back"]
    (tmp_path / "drawings/.made-by-colmap-ihe").unlink()
    assert folders_made_by(project, BY_RUN) == [] and drawings_of(project) == []


def test_the_frame_of_a_survey_becomes_that_of_its_drawings() -> None:
    up = np.array((0.0, 0.0, 1.0))
    empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    mapped = setting_of(DrawnModel(empty, up, up, Frame("EPSG:25832", (691_000, 5_334_000, 500))), {}, BY_RUN)
    assert (mapped.metric, mapped.plan_crs, mapped.offset) == (True, "EPSG:25832", (691_000, 5_334_000, 500))
    by_gps = setting_of(DrawnModel(empty, up, up, Frame(GPS, origin=(48.15, 11.57, 515.0))), {}, BY_RUN)
    assert by_gps.offset == (0, 0, 515)
    place = pyproj.Transformer.from_crs(by_gps.plan_crs, "EPSG:4326", always_xy=True).transform(30.0, -40.0)
    expected = Frame(GPS, origin=(48.15, 11.57, 515.0)).to_user(np.array([(30.0, -40.0, 0.0)]))[0]
    assert place == pytest.approx(expected[:2], abs=5e-9)  # half a millimetre
    assert setting_of(DrawnModel(empty, up, up, None), {}, BY_RUN).metric is False
