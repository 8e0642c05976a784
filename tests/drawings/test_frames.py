"""Frames of drawings: planes and unrolled cylinders, there and back."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.drawings.frames import cylinder_frame, plane_frame, plane_of_points

UP = np.array((0.0, 0.0, 1.0))
POINTS = np.random.default_rng(0).normal(0, 3, (50, 3))


def test_a_facade_has_its_heights_upwards_and_its_right_to_the_right() -> None:
    frame = plane_frame(np.array((4.0, 7.0, 9.0)), np.array((0.0, -2.0, 0.0)), UP)
    places = frame.to_drawing(np.array([(5.0, 6.0, 2.5), (5.0, 7.5, 2.5)]))
    assert places == pytest.approx(np.array([(5, 2.5, 1), (5, 2.5, -0.5)]))
    assert frame.to_model(frame.to_drawing(POINTS)) == pytest.approx(POINTS)


def test_a_plan_has_x_to_the_right_and_y_upwards_and_tells_heights() -> None:
    frame = plane_frame(np.zeros(3), UP, UP)
    assert frame.to_drawing(POINTS) == pytest.approx(POINTS)


def test_a_leaning_plane_keeps_its_height_at_its_origin() -> None:
    frame = plane_frame(np.array((0.0, 2.0, 0.0)), np.array((0.0, -1.0, 0.2)), UP)
    assert frame.origin @ UP == pytest.approx(0)
    assert frame.right == pytest.approx(np.array((1, 0, 0)))


def test_three_points_make_a_plane_that_looks_to_the_cameras() -> None:
    points = [np.array(p) for p in ((0.0, 2.0, 0.0), (3.0, 2.0, 0.0), (0.0, 2.0, 5.0))]
    assert plane_of_points(points, UP, np.array((0.0, -9.0, 1.0))).normal == pytest.approx(
        np.array((0, -1, 0))
    )
    assert plane_of_points(points, UP, np.array((0.0, 9.0, 1.0))).normal == pytest.approx(np.array((0, 1, 0)))
    with pytest.raises(ValueError, match="on a line"):
        plane_of_points([points[0], points[1], 2 * points[1] - points[0]], UP, np.zeros(3))


@pytest.mark.parametrize("inside", [False, True])
def test_a_cylinder_is_unrolled_as_it_is_seen(inside: bool) -> None:
    """From before it, at minus y: what is to the right of the middle is at plus x outside, and inside an apse too."""
    middle = np.array((1.0, 2.0, 3.0))
    frame = cylinder_frame(middle, UP, 2.0, UP, np.array((1.0, -9.0, 3.0)), inside=inside)
    near = -1 if not inside else 1  # an apse shows its far side
    angle = 0.1
    place = middle + np.array((2 * np.sin(angle), near * 2 * np.cos(angle), 0))
    assert frame.to_drawing(place) == pytest.approx(np.array((0.2, 3, 0)))
    towards = middle + np.array((1.9 * np.sin(angle), near * 1.9 * np.cos(angle), 0))
    assert frame.to_drawing(towards)[2] == pytest.approx(0.1 if inside else -0.1)
    assert frame.to_model(frame.to_drawing(POINTS)) == pytest.approx(POINTS)


def test_directions_of_no_length_are_refused() -> None:
    with pytest.raises(ValueError, match="no length"):
        plane_frame(np.zeros(3), np.zeros(3), UP)
    with pytest.raises(ValueError, match="radius of 0"):
        cylinder_frame(np.zeros(3), UP, 0.0, UP, np.ones(3))
