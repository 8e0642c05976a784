"""How many photographs see each place, and at what angles."""

from __future__ import annotations

import numpy as np
import pytest
from walls import wall_places

from colmap_ihe.colmap.checks.overlap import places_of


def test_a_wall_before_three_cameras_is_seen_by_three_and_at_the_angle_between_them() -> None:
    places, centres = wall_places((3.0, 6.0, 9.0), reach=20)
    assert (places.photographs == 3).all() and not places.few.any() and not places.narrow.any()
    assert places.side == pytest.approx(0.9 * 11.9 / 32, rel=0.02)
    below = places.middles[:, 0:1] - centres[[0, 2], 0]
    away = np.hypot(places.middles[:, 1] - 3, 5.0)
    expected = np.degrees(np.arctan2(below[:, 0], away) - np.arctan2(below[:, 1], away))
    assert places.angles_deg == pytest.approx(expected, abs=0.2)


def test_where_two_photographs_overlap_there_are_two_and_where_none_do_no_place() -> None:
    places, _ = wall_places((2.0, 5.0, 8.0, 11.0), reach=2.9)
    assert set(places.photographs) <= {2, 3}
    assert places.few.mean() > 0.9  # a square at an edge holds a bit of the next two
    assert places.middles[:, 0].min() >= 2.1 - places.side


def test_cameras_close_together_see_a_wall_from_one_side() -> None:
    places, _ = wall_places((5.9, 6.0, 6.1), reach=20)
    assert places.narrow.all() and places.angles_deg.max() == pytest.approx(2.3, abs=0.1)


def test_background_and_strays_are_no_places() -> None:
    draw = np.random.default_rng(0)
    wall = np.column_stack([draw.uniform(0, 10, 1000), draw.uniform(0, 5, 1000), np.zeros(1000)])
    far = np.column_stack([draw.uniform(-50, 50, (60, 2)), np.full(60, -100.0)])
    points, centres = np.concatenate([wall, far]), np.array([(2.0, 2, 5), (5, 2, 5), (8, 2, 5)])
    point, image = np.repeat(np.arange(len(points)), 3), np.tile(np.arange(3), len(points))
    places = places_of(points, point, image, centres)
    assert places is not None
    assert np.abs(places.middles[:, 2]).max() < 1
    assert places_of(points[:1], point[:3], image[:3], centres) is None
    apart = np.array([(0.0, 0, 0), (10, 0, 0), (0, 5, 0)])
    assert places_of(apart, np.repeat([0, 1, 2], 3), np.tile([0, 1, 2], 3), centres) is None
    nothing = np.zeros(0, np.intp)
    assert places_of(np.zeros((0, 3)), nothing, nothing, centres) is None
