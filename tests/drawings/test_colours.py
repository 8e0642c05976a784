"""Colours of a drawing, from photographs of a wall whose picture is known."""

from __future__ import annotations

import numpy as np
from drawn_wall import (
    FOOT,
    HEIGHT,
    NORMAL,
    RIGHT,
    UP,
    WIDTH,
    colour_at,
    in_niche,
    wall_mesh,
    wall_photographs,
)

from colmap_ihe.drawings.colours import paint
from colmap_ihe.drawings.frames import PlaneFrame
from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.painted import paint_mesh
from colmap_ihe.drawings.surface import drawn_faces, seen_surface
from colmap_ihe.drawings.view import resolution
from colmap_ihe.machine.executor import local_executor

FRAME = PlaneFrame(FOOT, RIGHT, UP, NORMAL)


def test_each_pixel_has_the_colour_of_its_place() -> None:
    """In the niche too, which photographs show elsewhere than the wall before it."""
    mesh = wall_mesh()
    with local_executor() as executor:
        surface = paint_mesh(mesh, *wall_photographs(), executor)
    faces = drawn_faces(mesh, FRAME, 1, 1)
    assert 0.0099 < resolution(surface, mesh, faces) < 0.0106  # 5 m away at 500 pixels, the niche farther
    grid = PixelGrid(0, HEIGHT, 0.01, round(WIDTH / 0.01), round(HEIGHT / 0.01))
    band = paint(surface, faces, seen_surface(faces, grid, 1, 1), FRAME, grid)
    across, up = np.meshgrid(grid.across(), grid.up())
    off = np.abs(band.rgb - colour_at(across, up)).max(axis=2)
    shown = band.by_photograph
    assert shown.all()
    assert np.median(off[shown]) < 1 and np.percentile(off[shown], 99) < 4
    assert np.median(off[shown & in_niche(across, up)]) < 1
