"""Views that show something else than the others."""

from __future__ import annotations

import numpy as np

from colmap_ihe.dense.camera import PinholeCamera
from colmap_ihe.dense.texture.agree import agreed_colours, at_corners, centre_colours, doubted
from colmap_ihe.dense.texture.mesh import Mesh

STONE, SKY = (150, 120, 90), (170, 200, 240)


def _doubted(quality: list[float], colours: list[tuple[int, int, int]]) -> list[float]:
    values = np.array([quality], np.float32), np.array([colours], np.uint8)
    return [float(value) for value in doubted(*values)[0]]


def test_the_view_that_misses_a_thing_is_doubted() -> None:
    brighter = (165, 132, 99)  # another exposure
    assert _doubted([9, 5, 4, 0], [SKY, STONE, brighter, SKY]) == [-9, 5, 4, 0]


def test_two_views_are_both_kept_and_those_beside_edges_have_no_vote() -> None:
    assert _doubted([9, 5, 0, 0], [SKY, STONE, STONE, STONE]) == [9, 5, 0, 0]
    assert _doubted([9, 5, -4, -3], [SKY, STONE, STONE, STONE]) == [9, 5, -4, -3]


def test_where_all_differ_none_is_doubted() -> None:
    assert _doubted([5, 4, 3], [(60, 60, 60), (120, 120, 120), (200, 200, 200)]) == [5, 4, 3]


def test_colours_are_those_at_the_centres() -> None:
    vertices = np.array([[-1, -1, 4], [1, -1, 4], [-1, 1, 4], [1, 1, 4]], np.float32)
    mesh = Mesh(vertices, np.array([[0, 2, 1], [1, 2, 3]], np.int32), np.zeros((4, 3), np.uint8))
    view = PinholeCamera(np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]]), np.eye(4)[:3], (100, 100))
    picture = np.zeros((100, 100, 3), np.uint8)
    picture[:50, :50], picture[50:, 50:] = STONE, SKY
    assert np.abs(centre_colours(mesh, view, picture) - np.array([STONE, SKY], float)).max() < 3


def test_photographs_agree_on_the_median_of_three_that_show_a_face() -> None:
    quality = np.array([[9, 5, 4, -3], [9, 5, 0, 0]], np.float32)
    colour = np.array([[STONE, STONE, SKY, SKY]] * 2, np.uint8)
    agreed = agreed_colours(quality, colour)
    assert agreed[0].tolist() == list(STONE) and np.isnan(agreed[1]).all()


def test_colours_of_faces_at_their_corners() -> None:
    faces = np.array([[0, 1, 2], [1, 2, 3], [4, 5, 6]], np.int32)
    corners = at_corners(faces, 7, np.array([[10, 10, 10], [30, 30, 30], [np.nan] * 3], np.float32))
    assert corners[:4, 0].tolist() == [10, 20, 20, 30] and np.isnan(corners[4:]).all()
