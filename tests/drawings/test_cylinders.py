"""Upright cylinders, fitted to a mesh."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.dense.camera import Float64
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.cylinders import fitted_cylinder

UP = np.array((0.0, 0.0, 1.0))


def half_tower(radius: float, noise: float) -> Mesh:
    """Return the half of a tower about (10, 20) that is seen, and a wall behind it."""
    angle, height = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 60), np.linspace(0, 6, 40))
    places = np.stack((10 + radius * np.sin(angle), 20 - radius * np.cos(angle), height), axis=-1)
    wall = np.stack(np.meshgrid(np.linspace(5, 15, 60), [20.0], np.linspace(0, 6, 40)), axis=-1)[0].transpose(
        1, 0, 2
    )
    vertices: list[Float64] = []
    faces = []
    for sheet in (places, wall):
        rows = sum(len(part) for part in vertices) + np.arange(2400).reshape(40, 60)
        a, b, c, d = rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]
        faces += [np.stack((a, b, c), -1).reshape(-1, 3), np.stack((a, c, d), -1).reshape(-1, 3)]
        vertices.append(sheet.reshape(-1, 3))
    every = np.concatenate(vertices) + np.random.default_rng(0).normal(0, noise, (4800, 3))
    return Mesh(
        every.astype(np.float32), np.concatenate(faces).astype(np.int32), np.zeros((4800, 3), np.uint8)
    )


def test_a_rough_guess_becomes_the_axis_and_the_radius() -> None:
    point, radius = fitted_cylinder(half_tower(2.5, 0.003), UP, np.array((10.3, 19.8, 3.0)), 2.2)
    assert point == pytest.approx(np.array((10, 20, 3)), abs=0.004)
    assert radius == pytest.approx(2.5, abs=0.004)


def test_where_there_is_none_nothing_is_fitted() -> None:
    with pytest.raises(ValueError, match="faces of the mesh are of an upright cylinder"):
        fitted_cylinder(half_tower(2.5, 0.003), UP, np.array((40.0, 19.8, 3.0)), 2.2)
