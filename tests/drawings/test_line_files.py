"""SVG and DXF, read back."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest

from colmap_ihe.drawings.line_files import write_dxf, write_svg
from colmap_ihe.drawings.lines import Layer, Line

TRIANGLE = Line(np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 1.0)]), closed=True)
OPEN = Line(np.array([(-1.0, -1.0), (0.5, 0.25)]))
LAYERS = [Layer("SECTION", [TRIANGLE], (190, 30, 45), 0.35), Layer("OUTLINE", [OPEN])]


def test_dxf_has_layers_in_metres_at_coordinates_of_the_survey(tmp_path: Path) -> None:
    write_dxf(tmp_path / "a.dxf", LAYERS, (691_000.0, 515.0), metric=True)
    document = ezdxf.readfile(tmp_path / "a.dxf")  # type: ignore[attr-defined]
    assert document.header["$INSUNITS"] == 6
    assert not document.audit().errors
    lines: Any = document.modelspace()
    first, second = lines
    assert (first.dxf.layer, first.closed, second.dxf.layer, second.closed) == (
        "SECTION",
        True,
        "OUTLINE",
        False,
    )
    assert np.array(first.get_points("xy")) == pytest.approx(
        TRIANGLE.points + np.array((691_000, 515)), abs=1e-9
    )
    assert document.layers.get("SECTION").rgb == (190, 30, 45)
    write_dxf(tmp_path / "b.dxf", LAYERS, (0, 0), metric=False)
    assert ezdxf.readfile(tmp_path / "b.dxf").header["$INSUNITS"] == 0  # type: ignore[attr-defined]


def test_svg_prints_to_scale_and_keeps_coordinates(tmp_path: Path) -> None:
    write_svg(tmp_path / "a.svg", LAYERS, (100.0, 10.0), 50, "a & b")
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    x, y, width, height = map(float, root.attrib["viewBox"].split())
    assert float(root.attrib["width"].removesuffix("mm")) == pytest.approx(20 * width, abs=0.01)
    assert (x < 99, y < -11, x + width > 102, y + height > -9) == (True,) * 4
    polygon = root.find(".//{*}g[@id='SECTION']/{*}polygon")
    assert polygon is not None
    assert polygon.attrib["points"] == "100.0000,-10.0000 102.0000,-10.0000 102.0000,-11.0000"
    assert root.findtext("{*}title") == "a & b"


def test_svg_that_is_not_metric_has_a_size_all_the_same(tmp_path: Path) -> None:
    write_svg(tmp_path / "a.svg", LAYERS, (0.0, 0.0), None, "a")
    assert ElementTree.parse(tmp_path / "a.svg").getroot().attrib["width"] == "200.000mm"
