"""All files of a drawing, of a wall that is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
import rasterio
from drawn_wall import FOOT, HEIGHT, NICHE, NORMAL, RIGHT, UP, WIDTH, colour_at, wall_mesh, wall_photographs
from PIL import Image

from colmap_ihe.drawings.frames import PlaneFrame, plane_frame
from colmap_ihe.drawings.make import draw_section, draw_surface
from colmap_ihe.drawings.painted import paint_mesh
from colmap_ihe.drawings.view import Setting, View
from colmap_ihe.machine.executor import local_executor

SETTING = Setting(True, UP, (0.0, 0.0, 500.0), title={"object": "wall"})
FRAME = PlaneFrame(FOOT, RIGHT, UP, NORMAL)


def test_a_facade_becomes_all_its_files(tmp_path: Path) -> None:
    mesh = wall_mesh()
    with local_executor() as executor:
        surface = paint_mesh(mesh, *wall_photographs(), executor)
    about = draw_surface(tmp_path, View("wall", "facade", FRAME, pixel=0.02), mesh, surface, SETTING)
    assert json.loads((tmp_path / "drawing.json").read_text()) == about
    assert {file.name for file in tmp_path.iterdir()} == {*about["files"], "drawing.json"} | {
        "preview.jpg", "preview-relief.jpg"
    }  # fmt: skip
    assert about["shift"] == [0, 500] and about["holes_percent"] < 2
    with rasterio.open(tmp_path / "relief.tif") as file:
        relief, place = file.read(1), file.transform
    with rasterio.open(tmp_path / "orthophoto.tif") as file:
        rgb = np.moveaxis(file.read(), 0, 2)
    across, height = (0.31, 2.43)
    column, row = int((across - place.c) / place.a), int((height + 500 - place.f) / place.e)
    u, v = place.c + (column + 0.5) * place.a, place.f + (row + 0.5) * place.e - 500
    assert rgb[row, column, :3] == pytest.approx(colour_at(np.array(u), np.array(v)), abs=3)
    assert relief[row, column] == pytest.approx(0, abs=0.01)
    row, column = int((1.5 + 500 - place.f) / place.e), int((2.0 - place.c) / place.a)
    assert relief[row, column] == pytest.approx(-1000 * NICHE, abs=0.01)
    space: Any = ezdxf.readfile(tmp_path / "lines.dxf").modelspace()  # type: ignore[attr-defined]
    outline = np.array(
        [p for line in space.query('LWPOLYLINE[layer=="OUTLINE"]') for p in line.get_points("xy")]
    )
    assert np.ptp(outline, axis=0) == pytest.approx(np.array((WIDTH, HEIGHT)), abs=0.05)
    assert outline[:, 1].min() == pytest.approx(500, abs=0.03)
    with Image.open(tmp_path / "preview.jpg") as preview:
        assert preview.size == (about["width"], about["height"])


def test_a_section_becomes_lines_in_metres(tmp_path: Path) -> None:
    """A level cut through the niche: the wall left and right of it, and its back."""
    view = View("low", "section", plane_frame(FOOT + 1.5 * UP, UP, UP))
    about = draw_section(tmp_path, view, wall_mesh(), SETTING)
    assert about["length"] == pytest.approx(WIDTH, abs=1e-4)
    space: Any = ezdxf.readfile(tmp_path / "lines.dxf").modelspace()  # type: ignore[attr-defined]
    places = [np.array(line.get_points("xy")) - FOOT[:2] for line in space]
    out = np.concatenate(places) @ NORMAL[:2]
    assert set(out.round(4)) == {0.0, -NICHE}
