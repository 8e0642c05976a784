"""Sections of a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_wall import box

from colmap_ihe.drawings.frames import plane_frame
from colmap_ihe.drawings.lines import Line, bounds_of, length_of, lines_drawn, section

UP = np.array((0.0, 0.0, 1.0))


def test_a_level_cut_of_a_house_is_its_plan() -> None:
    (line,) = joined(section(box((8.0, 5.0, 4.0)), plane_frame(1.3 * UP, UP, UP)))
    assert bounds_of([line]) == pytest.approx((0, 0, 8, 5))


def joined(lines: list[Line]) -> list[Line]:
    """Walls of the box share no vertices: their four lines, as one."""
    assert length_of(lines) == pytest.approx(26, abs=1e-5)
    return [Line(np.concatenate([line.points for line in lines]))]


def test_an_upright_cut_shows_walls_and_roof_and_is_open_below() -> None:
    frame = plane_frame(np.array((3.1, 0.0, 0.0)), np.array((1.0, 0.0, 0.0)), UP)
    lines = section(box((8.0, 5.0, 4.0)), frame)
    assert length_of(lines) == pytest.approx(4 + 5 + 4, abs=1e-5)
    assert bounds_of(lines) == pytest.approx((0, 0, 5, 4))


def test_a_cut_through_vertices_and_along_edges_is_one_closed_line() -> None:
    """An octahedron, cut through four of its corners."""
    from colmap_ihe.dense.texture.mesh import Mesh

    corners = np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], np.float32)
    faces = [(k, (k + 1) % 4, 4) for k in range(4)] + [((k + 1) % 4, k, 5) for k in range(4)]
    mesh = Mesh(corners, np.array(faces, np.int32), np.zeros((6, 3), np.uint8))
    (line,) = section(mesh, plane_frame(np.zeros(3), UP, UP))
    assert line.closed and length_of([line]) == pytest.approx(4 * 2**0.5)


def test_beside_a_mesh_there_is_nothing() -> None:
    assert section(box((8.0, 5.0, 4.0)), plane_frame(9 * UP, UP, UP)) == []
    with pytest.raises(ValueError, match="no lines"):
        bounds_of([])


def test_lines_are_drawn_where_they_are() -> None:
    picture = lines_drawn([Line(np.array([(0.0, 0.0), (2.0, 1.0)]))], 200)
    assert picture.shape == (106, 200, 3)
    dark = picture[..., 0] < 128
    assert dark[:30, -40:].any() and dark[-30:, :40].any() and not dark[:30, :40].any()
