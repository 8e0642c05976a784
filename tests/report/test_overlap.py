"""Drawings of overlap and of cameras."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.report.overlap import map_drawing, plan_drawing
from colmap_ihe.report.survey_contents import CameraPlan, OverlapMap


def test_squares_stand_where_they_are_with_the_top_above() -> None:
    cells = np.array([(0, 0), (2, 1), (1, 0), (1, 1)])
    drawing = map_drawing(
        OverlapMap("from above", cells, np.array([2, 12, 3, 11]), np.array([False, False, True, False]))
    )
    assert drawing is not None
    assert (drawing.width, drawing.height) == (3, 2)
    paths = {part.photographs: part.path for part in drawing.parts}
    assert paths["1 or 2"] == "M0 1h1v1h-1z" and paths["10 or more"] == "M1 0h2v1h-2z"
    assert paths["3"] == "M1 1h1v1h-1z" and paths["4 or 5"] == "" == paths["6 to 9"]
    assert sum(part.share for part in drawing.parts) == pytest.approx(1)
    assert drawing.narrow == "M1.5 1.5h0"
    nothing = np.zeros(0, np.int64)
    assert map_drawing(OverlapMap("", nothing.reshape(0, 2), nothing, nothing > 0)) is None


def test_a_plan_keeps_proportions_and_opens_cameras_to_where_they_look() -> None:
    plan = CameraPlan(
        "from above", np.array([(5.0, 4.0)]), 1.0,
        np.array([(0.0, 0), (10, 0)]), np.array([(0.0, 1), (0, 1)]), ["a", "b"],
    )  # fmt: skip
    drawing = plan_drawing(plan, {"a": 7})
    assert drawing.height == pytest.approx(58 * 4 + 60)
    assert drawing.ground == "M291 1h58v58h-58z"
    assert drawing.cameras[0].path == "M30.0 262.0L38.1 244.0L21.9 244.0z"
    assert [camera.number for camera in drawing.cameras] == ["7", ""]
    assert drawing.bar_length == 2.0 and drawing.bar == pytest.approx(116)
