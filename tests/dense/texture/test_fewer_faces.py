"""A mesh with fewer triangles keeps its shape, its texture and its seams."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from colmap_ihe.dense.texture.fewer_faces import fewer_faces


def sheet(side: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A square of side 1 in (side + 1)**2 vertices."""
    y, x = np.mgrid[0 : side + 1, 0 : side + 1] / side
    n = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = n[:-1, :-1].ravel(), n[:-1, 1:].ravel(), n[1:, :-1].ravel(), n[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), faces


def areas(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    corners = vertices[faces]
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2)


def test_a_plane_keeps_its_border_and_no_triangle_turns_over() -> None:
    vertices, faces = sheet(40)
    fewer = fewer_faces(vertices, faces, 200)
    assert len(fewer) <= 210 < len(faces) == 3200
    area = areas(vertices, fewer)
    assert (area > 0).all() and area.sum() == pytest.approx(1)


def test_a_sphere_stays_one() -> None:
    ball = trimesh.creation.icosphere(5)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, np.int64)
    fewer = trimesh.Trimesh(vertices, fewer_faces(vertices, faces, 2000), process=False)
    assert len(fewer.faces) == pytest.approx(2000, abs=2)
    assert fewer.volume == pytest.approx(ball.volume, rel=0.02)
    assert np.linalg.norm(fewer.triangles_center, axis=1).min() > 0.97
    assert fewer.is_watertight


def test_patches_of_the_texture_still_meet() -> None:
    """Two sheets side by side, whose vertices at the common edge stand twice: they go along it, in both alike."""
    vertices, faces = sheet(20)
    both = np.concatenate([vertices, vertices + np.array([1, 0, 0])])
    fewer = fewer_faces(both, np.concatenate([faces, faces + len(vertices)]), 140)
    assert len(fewer) <= 150
    assert ((fewer < len(vertices)).all(axis=1) | (fewer >= len(vertices)).all(axis=1)).all()
    seam = [np.flatnonzero(np.isclose(part[:, 0], 1)) for part in (vertices, both)]
    left, right = np.intersect1d(seam[0], fewer), np.intersect1d(seam[1][21:], fewer)
    assert 2 <= len(left) < 15
    assert np.array_equal(both[left], both[right])
    assert (areas(both, fewer) > 0).all() and areas(both, fewer).sum() == pytest.approx(2)


def test_what_is_few_enough_is_left_as_it_is() -> None:
    vertices, faces = sheet(4)
    assert np.array_equal(fewer_faces(vertices, faces, 32), faces)
    assert fewer_faces(np.zeros((0, 3)), np.zeros((0, 3), np.int64), 10).shape == (0, 3)
