"""Façades that are found in a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_wall import FOOT, HEIGHT, NORMAL, UP, WIDTH, box, wall_mesh

from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.planes import extent_of, find_facades
from colmap_ihe.drawings.surface import drawn_faces


def test_a_wall_is_found_to_a_millimetre_through_noise_and_with_its_niche() -> None:
    mesh = wall_mesh()
    noise = np.random.default_rng(3).normal(0, 0.004, (len(mesh.vertices), 3))
    rough = Mesh((mesh.vertices + noise).astype(np.float32), mesh.faces, mesh.colours)
    (facade,) = find_facades(rough, UP)
    assert facade.name == "front"
    assert np.degrees(np.arccos(facade.frame.normal @ NORMAL)) < 0.05
    assert abs(facade.frame.to_drawing(FOOT + 1.5 * UP)[2]) < 0.001
    assert facade.frame.normal @ UP == 0 and facade.frame.up == pytest.approx(UP)  # plumb


def test_the_walls_of_a_house_are_named_as_from_before_its_front() -> None:
    facades = find_facades(box((8.0, 5.0, 4.0)), UP)
    normals = {f.name: f.frame.normal.round(6).tolist() for f in facades}
    front = facades[0]
    assert front.name == "front" and front.area == pytest.approx(32)
    assert set(normals) == {"front", "back", "left", "right"}
    assert normals["back"] == [-n for n in normals["front"]]
    assert normals["right"] == front.frame.right.round(6).tolist()


def test_small_sides_are_no_facades_and_a_floor_has_none() -> None:
    assert {f.name for f in find_facades(box((9.0, 1.0, 4.0)), UP)} == {"front", "back"}
    flat = box((8.0, 5.0, 4.0)).with_faces(np.arange(5 * 288) >= 4 * 288)
    assert find_facades(flat, UP) == []


def test_a_drawing_reaches_as_far_as_what_looks_its_way() -> None:
    (facade,) = find_facades(wall_mesh(), UP)
    left, bottom, right, top = extent_of(drawn_faces(wall_mesh(), facade.frame, 1, 1))
    assert [right - left, top - bottom, bottom] == pytest.approx([WIDTH, HEIGHT, 0], abs=0.06)
    with pytest.raises(ValueError, match="no face"):
        extent_of(drawn_faces(wall_mesh(), facade.frame, 0, -1))
