"""What a user asks for becomes views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_wall import FOOT, HEIGHT, NORMAL, RIGHT, UP, WIDTH, on_wall, wall_mesh

from colmap_ihe.drawings.choose import DrawnModel, chosen_views, view_of
from colmap_ihe.drawings.frames import CylinderFrame, PlaneFrame
from colmap_ihe.drawings.view import Setting, layout_of
from colmap_ihe.errors import OptionError
from colmap_ihe.project.option_sections import DrawingsOptions, DrawingView
from colmap_ihe.survey.frames import Frame

OFFSET = (691_000.0, 5_334_000.0, 500.0)
MODEL = DrawnModel(wall_mesh(), UP, on_wall(np.array(2.0), np.array(1.5), 5.0), Frame("EPSG:25832", OFFSET))
SETTING = Setting(True, UP, OFFSET)


def frame_of(
    options: DrawingsOptions | None = None, model: DrawnModel = MODEL, **asked: object
) -> PlaneFrame:
    view = view_of("a", DrawingView.model_validate(asked), options or DrawingsOptions(), model)
    assert isinstance(view.frame, PlaneFrame)
    return view.frame


def test_without_views_there_are_facades_plan_and_sections() -> None:
    views = chosen_views(DrawingsOptions(), MODEL)
    assert [(view.name, view.kind) for view in views] == [
        ("front", "facade"), ("plan", "plan"), ("section", "section"), ("level", "section"),
    ]  # fmt: skip
    section, level = views[2].frame, views[3].frame
    middle = on_wall(np.array(WIDTH / 2), np.array(0.0))
    assert abs(section.to_drawing(middle)[2]) < 0.05 and abs(section.to_drawing(FOOT)[2]) == pytest.approx(
        2, abs=0.05
    )
    assert level.to_drawing(on_wall(np.array(1.0), np.array(0.2 * HEIGHT)))[2] == pytest.approx(0, abs=0.02)
    (only,) = chosen_views(DrawingsOptions(), MODEL, "plan")
    assert only.name == "plan"


def test_coordinates_are_those_of_the_survey() -> None:
    point = FOOT + OFFSET
    for numbers in (
        [*point, *NORMAL],
        [*point, *(point + RIGHT), *(point + UP)],
        [*(point + UP), *point, *(point + RIGHT)],
    ):
        frame = frame_of(plane=[float(n) for n in numbers])
        assert frame.normal == pytest.approx(NORMAL) and frame.to_drawing(FOOT)[2] == pytest.approx(
            0, abs=1e-6
        )
    level = frame_of(height=501.25)
    assert level.to_drawing(np.array((0, 0, 1.25)))[2] == pytest.approx(0)
    x, y, _ = FOOT + OFFSET
    to_x, to_y, _ = FOOT + OFFSET + RIGHT
    along = frame_of(section=[float(n) for n in (x, y, to_x, to_y)])
    assert along.right == pytest.approx(RIGHT) and along.to_drawing(FOOT)[2] == pytest.approx(0, abs=1e-6)


def test_heights_and_maps_are_told_in_the_survey() -> None:
    facade, plan = chosen_views(DrawingsOptions(views={"front": DrawingView(), "plan": DrawingView()}), MODEL)
    assert SETTING.shift(facade) == (0, 500) and SETTING.shift(plan) == OFFSET[:2]
    level = view_of("a", DrawingView(height=501.0), DrawingsOptions(), MODEL)
    lying = view_of("b", DrawingView(cylinder=[*OFFSET, 1, 0, 0, 2]), DrawingsOptions(), MODEL)
    mapped = replace(SETTING, plan_crs="EPSG:25832")
    assert SETTING.shift(level) == OFFSET[:2]
    assert [mapped.upwards(view) for view in (facade, plan, level, lying)] == ["plumb", "N", "N", "axis"]
    assert [replace(SETTING, metric=False).upwards(view) for view in (facade, plan)] == ["up", "y"]


def test_options_of_a_view_go_over_those_of_all() -> None:
    options = DrawingsOptions(mm_per_pixel=5, scale=100, views={"front": DrawingView(scale=20)})
    (view,) = chosen_views(options, MODEL)
    assert (view.pixel, view.scale) == (0.005, 20)


def test_a_cylinder_with_direction_is_taken_as_it_is() -> None:
    numbers = [*(FOOT + OFFSET + (0, 0, 7)), 0.0, 0.0, -1.0, 2.0]
    view = view_of("a", DrawingView(cylinder=[float(n) for n in numbers]), DrawingsOptions(), MODEL)
    assert isinstance(view.frame, CylinderFrame) and view.frame.radius == 2
    assert view.frame.axis == pytest.approx(UP) and view.frame.origin == pytest.approx(FOOT)


def test_what_cannot_be_drawn_says_why() -> None:
    with pytest.raises(OptionError, match="no drawing is called 'x'"):
        chosen_views(DrawingsOptions(), MODEL, "x")
    with pytest.raises(OptionError, match="no façade is called back"):
        frame_of(of="back")
    with pytest.raises(OptionError, match="three points lie on a line"):
        frame_of(plane=[0.0, 0, 0, 1, 1, 1, 2, 2, 2])
    with pytest.raises(OptionError, match="a direction of no length"):
        frame_of(plane=[0.0, 0, 0, 0, 0, 0])
    with pytest.raises(OptionError, match="faces of the mesh are of an upright cylinder"):
        frame_of(cylinder=[*OFFSET, 0.3])
    with pytest.raises(OptionError, match="5 mm, and the model is not metric"):
        frame_of(model=DrawnModel(MODEL.mesh, UP, MODEL.cameras, None), mm_per_pixel=5.0)


def test_planes_that_miss_and_pixels_too_many_are_refused_with_what_would_do() -> None:
    far = view_of("far", DrawingView(plane=[0.0, 0, 0, *NORMAL.tolist()]), DrawingsOptions(), MODEL)
    with pytest.raises(OptionError, match="drawing far: misses the model") as caught:
        layout_of(far, MODEL.mesh, SETTING)
    assert "x 691003.00 to 691006.76" in caught.value.hint
    (fine,) = chosen_views(DrawingsOptions(mm_per_pixel=0.03, views={"front": DrawingView()}), MODEL)
    with pytest.raises(OptionError, match=r"pixels of 0.03 mm make \d+ x \d+ of them, 1.3e\+10") as caught:
        layout_of(fine, MODEL.mesh, SETTING)
    assert caught.value.hint == "give pixels of 0.11 mm or more"
