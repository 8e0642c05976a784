"""The small picture of a model."""

from __future__ import annotations

import dataclasses

import numpy as np
from synthetic import facade_cloud, facade_surface

from colmap_ihe.report.contents import Cloud, Surface
from colmap_ihe.report.model_picture import model_picture

PAPER = (243, 243, 243)


def red_wall() -> Surface:
    """6 by 4 units at z = 0, in triangles."""
    steps = np.linspace(0, 1, 60)
    places = np.array([(6 * u - 3, 4 * v - 2, 0) for v in steps for u in steps], np.float32)
    corner = np.array([r * 60 + c for r in range(59) for c in range(59)])
    faces = np.stack([corner, corner + 1, corner + 60], axis=1)
    colours = np.tile(np.array([200, 20, 10], np.uint8), (len(places), 1))
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(places), 1))
    return Surface(places, normals, faces, [], len(faces), colours=colours)


def test_a_wall_is_drawn_whole_lit_and_within_the_picture() -> None:
    drawn = model_picture(red_wall(), facade_cloud(10), 120, 80)
    assert drawn.shape == (80, 120, 3)
    middle = drawn[30:50, 45:75].reshape(-1, 3)
    assert (middle == middle[0]).all()  # without a hole
    assert 140 < middle[0, 0] < 200 and middle[0, 1] < 20
    assert tuple(drawn[0, 0]) == PAPER == tuple(drawn[-1, -1])


def test_a_textured_wall_has_the_colours_of_its_texture() -> None:
    surface = facade_surface()
    drawn = model_picture(surface, facade_cloud(10), 240, 160).astype(int)
    assert (drawn[10:20, 100:140] != PAPER).any()
    sky, stone = drawn[25:32, 100:140].mean(axis=(0, 1)), drawn[75:90, 60:180].mean(axis=(0, 1))
    assert sky[2] > sky[0] and stone[0] > stone[2]  # blue above, warm below


def test_points_far_away_do_not_shrink_the_model_and_nothing_is_a_blank() -> None:
    cloud = facade_cloud(4000)
    strays = np.full((20, 3), 500, np.float32)
    far = dataclasses.replace(
        cloud,
        positions=np.concatenate([cloud.positions, strays, np.full((1, 3), np.nan, np.float32)]),
        colours=np.concatenate([cloud.colours, np.zeros((21, 3), np.uint8)]),
    )
    drawn = model_picture(None, far, 120, 80)
    assert (drawn != PAPER).any(axis=2).mean() > 0.4
    none = Cloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros(0, np.uint8), "sparse", 0)
    assert (model_picture(None, none, 12, 8) == PAPER).all()
