"""Maps of overlap, where it is weak, and the plan of cameras."""

from __future__ import annotations

import numpy as np
import pytest
from walls import wall_places

from colmap_ihe.pipeline.overlap_maps import (
    ABOVE,
    BACK,
    BELOW,
    FRONT,
    LEFT,
    RIGHT,
    camera_plan,
    overlap_map,
    views_of,
    weak_parts,
)  # fmt: skip

NAMES = ["a", "b", "c", "d", "e"]


def test_views_follow_where_photographs_look() -> None:
    around = np.array([(np.sin(a), 0, np.cos(a)) for a in np.radians(np.arange(0, 360, 30))])
    assert views_of(np.array([(0, 0, -1), (0.3, 0, -0.95)])) == [FRONT]
    assert views_of(np.array([(0, -1, 0), (0.1, -0.99, 0)])) == [ABOVE]
    assert views_of(np.array([(0, 1, 0)])) == [BELOW]
    assert views_of(around) == [FRONT, RIGHT, BACK, LEFT]


@pytest.mark.parametrize("view", [FRONT, ABOVE, BELOW, RIGHT, BACK, LEFT])
def test_axes_of_a_view_are_of_one_hand(view: object) -> None:
    right, up, toward = (np.array(getattr(view, name)) for name in ("right", "up", "toward"))
    assert np.array_equal(np.cross(right, up), toward)


def test_a_map_shows_counts_where_they_are_and_the_nearest_of_a_line() -> None:
    places, _ = wall_places((0.0, 1.5, 3.0, 4.5, 6.0), reach=4)
    shown = overlap_map(places, FRONT)
    assert shown.cells.min(axis=0).tolist() == [0, 0] and len(shown.cells) == len(places.middles)
    column = shown.cells[:, 0]
    assert shown.photographs[column == column.max()].max() == 2
    assert shown.photographs[column == 4].min() >= 4
    aside = overlap_map(places, RIGHT)  # the whole wall is in one line there, its right edge nearest
    assert aside.cells[:, 0].tolist() == [0] * len(aside.cells) and set(aside.photographs) == {2}


def test_weak_parts_are_named_as_the_map_shows_them() -> None:
    places, _ = wall_places((0.0, 1.5, 3.0, 4.5, 6.0), reach=4)
    parts = weak_parts(places, places.few, [FRONT], NAMES)
    assert {part.where for part in parts} == {"top right", "right", "bottom right"}
    assert all(set(part.beside) == {"d", "e"} for part in parts)
    assert weak_parts(places, places.few & False, [FRONT], NAMES) == []
    around = weak_parts(places, places.few, [FRONT, RIGHT, BACK, LEFT], NAMES)
    assert {part.where for part in around} == {
        "bottom of the right",
        "middle of the right",
        "top of the right",
    }


def test_the_plan_is_from_above_unless_cameras_stand_above_each_other() -> None:
    looks = np.array([(0.0, 0, -1), (0, 0, -1)])
    row, column = np.array([(0.0, 0, 5), (4, 0, 6)]), np.array([(0.0, 0, 5), (0, 4, 5)])
    places, _ = wall_places((0.0, 1.5, 3.0), reach=4)
    above = camera_plan(places, row, looks, ["a", "b"])
    assert above.view == "from above" and above.centres.tolist() == [[0, -5], [4, -6]]
    assert above.directions.tolist() == [[0, 1], [0, 1]]
    assert np.ptp(above.ground[:, 1]) == 0 and np.abs(above.ground[0, 1]) <= places.side
    assert np.diff(above.ground[:, 0]) == pytest.approx(places.side)
    assert camera_plan(places, column, looks, ["a", "b"]).view == "from the front"
