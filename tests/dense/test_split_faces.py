"""Faces are split where a mesh bends, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.dense.camera import Float32
from colmap_ihe.dense.split_faces import split_where_bent
from colmap_ihe.dense.texture.mesh import Mesh


def sheet(folds: Float32, cells: int = 12) -> Mesh:
    """Return a grid over the unit square, whose heights at its columns are `folds` (cells + 1,)."""
    across, up = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1))
    rows = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]))
    faces = np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1))).astype(np.int32)
    heights = np.broadcast_to(folds, across.shape)
    vertices = np.stack((across, up, heights), axis=-1).reshape(-1, 3).astype(np.float32)
    colours = np.repeat((200 * across.reshape(-1, 1)).astype(np.uint8), 3, axis=1)
    return Mesh(vertices, faces, colours)


def step() -> Mesh:
    """Return a sheet with a step of 0.3 between its sixth column and its seventh."""
    return sheet(np.where(np.arange(13) > 6, 0.3, 0.0).astype(np.float32))


def area(mesh: Mesh) -> float:
    return float(np.linalg.norm(mesh.normals, axis=1).sum() / 2)


@pytest.mark.parametrize("most", [289, 300, 340, 420, 900])
def test_no_more_faces_than_allowed_and_the_same_shape(most: int) -> None:
    mesh = step()
    finer = split_where_bent(mesh, most)
    assert len(mesh.faces) <= len(finer.faces) <= most
    assert area(finer) == pytest.approx(area(mesh), rel=1e-6)
    assert np.array_equal(finer.vertices[: len(mesh.vertices)], mesh.vertices)
    assert (finer.normals[:, 2] > 0).all()  # none is turned over


def test_most_of_the_room_is_used_where_there_is_enough_that_bends() -> None:
    assert len(split_where_bent(step(), 420).faces) > 400


@pytest.mark.parametrize("most", [300, 340, 420])
def test_there_are_no_gaps(most: int) -> None:
    """Each side is of two faces, but for those round the sheet."""
    faces = split_where_bent(step(), most).faces
    sides, times = np.unique(
        np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_counts=True
    )
    assert times.max() == 2
    vertices = split_where_bent(step(), most).vertices[sides[times == 1]]
    on_edge = np.isclose(vertices[..., :2], 0) | np.isclose(vertices[..., :2], 1)
    assert on_edge.all(axis=1).any(axis=1).all()


def test_new_vertices_are_at_the_step_with_colours_between() -> None:
    mesh = step()
    finer = split_where_bent(mesh, 420)
    new = finer.vertices[len(mesh.vertices) :]
    assert len(new) > 50
    assert abs(new[:, 0] - 6.5 / 12).max() < 2 / 12
    colours = finer.colours[len(mesh.vertices) :, 0].astype(float)
    assert colours == pytest.approx(200 * new[:, 0], abs=1.5)


def test_the_sharpest_bend_comes_first() -> None:
    """One fold of 10 degrees, another of 45; there is room for the faces of one."""
    columns = np.arange(13, dtype=np.float32) / 12
    folds = 0.18 * np.maximum(columns - 0.25, 0) + 1.4 * np.maximum(columns - 0.75, 0)
    mesh = sheet(folds.astype(np.float32))
    new = split_where_bent(mesh, 360).vertices[len(mesh.vertices) :]
    assert len(new) and (new[:, 0] > 0.6).all()


def test_a_flat_mesh_stays() -> None:
    mesh = sheet(np.zeros(13, np.float32))
    assert len(split_where_bent(mesh, 900).faces) == len(mesh.faces)


@pytest.mark.parametrize("most", [0, 288])
def test_without_room_a_mesh_stays(most: int) -> None:
    mesh = step()
    assert split_where_bent(mesh, most) is mesh


def test_a_mesh_without_faces() -> None:
    empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    assert split_where_bent(empty, 100) is empty
