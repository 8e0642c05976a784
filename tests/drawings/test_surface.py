"""What of a mesh is seen on a drawing."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_wall import FOOT, HEIGHT, NICHE, NORMAL, RIGHT, UP, WIDTH, in_niche, wall_mesh

from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.frames import PlaneFrame, cylinder_frame, plane_frame
from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.surface import drawn_faces, seen_surface

FRAME = PlaneFrame(FOOT, RIGHT, UP, NORMAL)


def test_each_pixel_tells_how_far_out_the_nearest_face_is() -> None:
    grid = PixelGrid(-0.1, HEIGHT + 0.1, 0.02, round((WIDTH + 0.2) / 0.02), round((HEIGHT + 0.2) / 0.02))
    seen = seen_surface(drawn_faces(wall_mesh(), FRAME, 1, 1), grid, 1, 1)
    across, up = np.meshgrid(grid.across(), grid.up())
    on_wall = (across > 0) & (across < WIDTH) & (up > 0) & (up < HEIGHT)
    assert np.array_equal(~np.isnan(seen.out), on_wall) and np.array_equal(seen.row >= 0, on_wall)
    expected = np.where(in_niche(across, up), -NICHE, 0)
    assert seen.out[on_wall] == pytest.approx(expected[on_wall], abs=1e-5)


def test_what_is_too_far_from_the_plane_is_not_drawn() -> None:
    grid = PixelGrid(0, HEIGHT, 0.05, 80, 60)
    faces = drawn_faces(wall_mesh(), FRAME, 0.1, 0.1)
    seen = seen_surface(faces, grid, 0.1, 0.1)
    assert np.isnan(seen.out).sum() == 400  # the niche, a square metre
    assert len(faces.face) == 2 * (80 * 60 - 400)


def test_the_back_of_a_wall_is_not_drawn() -> None:
    behind = plane_frame(FOOT, -NORMAL, UP)
    assert not len(drawn_faces(wall_mesh(), behind, 9, 9).face)


def test_a_drawing_of_more_than_a_tile_is_one() -> None:
    """Of two triangles, so that each reaches over tiles."""
    corners = np.array([(0, 0, 0), (3, 0, 0), (3, 0, 1), (0, 0, 1)], np.float32)
    square = Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)], np.int32), np.zeros((4, 3), np.uint8))
    frame = plane_frame(np.zeros(3), np.array((0.0, -1.0, 0.0)), UP)
    seen = seen_surface(drawn_faces(square, frame, 1, 1), PixelGrid(0, 1, 0.001, 3000, 1000), 1, 1)
    assert not np.isnan(seen.out).any() and set(np.unique(seen.row)) == {0, 1}


def test_a_cylinder_is_closed_where_its_drawing_ends() -> None:
    """Of 64 sides: faces that reach over the seam are drawn at both ends."""
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    ring = np.stack((np.cos(angle), np.sin(angle), np.zeros(64)), axis=1)
    vertices = np.concatenate((ring, ring + UP)).astype(np.float32)
    k, after = np.arange(64), (np.arange(64) + 1) % 64
    faces = np.concatenate((np.stack((k, after, after + 64), 1), np.stack((k, after + 64, k + 64), 1)))
    drum = Mesh(vertices, faces.astype(np.int32), np.zeros((128, 3), np.uint8))
    frame = cylinder_frame(np.zeros(3), UP, 1.0, UP, np.array((3.0, 0.2, 0.0)))
    grid = PixelGrid(-np.pi, 1, np.pi / 300, 600, 90)
    seen = seen_surface(drawn_faces(drum, frame, 0.1, 0.1), grid, 0.1, 0.1)
    assert not np.isnan(seen.out).any()
    assert np.abs(seen.out).max() < 0.002
