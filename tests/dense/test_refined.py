"""Vertices of a mesh go to where the depth maps of photographs say that the surface is."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from drawn_wall import FOOT, HEIGHT, NORMAL, RIGHT, UP, WIDTH, camera_at, on_wall

from colmap_ihe.dense import refined
from colmap_ihe.dense.camera import Float32, Float64
from colmap_ihe.dense.depth_maps import DepthMap
from colmap_ihe.dense.ply import read_mesh, write_mesh
from colmap_ihe.dense.refined import refine_surface, refined_mesh
from colmap_ihe.dense.texture.mesh import Mesh, vertex_normals
from colmap_ihe.machine.progress import SILENT

NEAR = (1.0, 1.5, 2.0, 2.5, 3.0)


def flat_wall(cells: int = 20) -> Mesh:
    across, up = np.meshgrid(np.linspace(0, WIDTH, cells + 1), np.linspace(0, HEIGHT, cells + 1))
    rows = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]))
    faces = np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1))).astype(np.int32)
    vertices = on_wall(across.ravel(), up.ravel()).astype(np.float32)
    return Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))


def depth_of(across: float, out: float) -> DepthMap:
    """Return the depth map of a camera that sees a wall so far out of the true one."""
    depth = np.full((480, 640), 5.0 - out, np.float32)
    return DepthMap(camera_at(across), lambda: depth, Path())


def out_of(mesh: Mesh) -> Float64:
    return np.asarray((mesh.vertices - FOOT) @ NORMAL)


def test_a_vertex_goes_to_the_median_of_the_depths_of_its_photographs() -> None:
    """Three photographs say 12 mm, one nothing near, one 30 mm: no mean of them."""
    said = zip(NEAR, (0.012, 0.012, 0.012, 0.5, 0.03), strict=True)
    mesh, moved = refined_mesh(flat_wall(), [depth_of(across, out) for across, out in said])
    middle = (abs((mesh.vertices - FOOT) @ RIGHT - 2) < 0.7) & (abs((mesh.vertices - FOOT) @ UP - 1.5) < 1)
    assert middle.sum() > 50 and moved[middle].all()
    assert out_of(mesh)[middle] == pytest.approx(0.012, abs=1e-5)


def test_what_fewer_than_three_photographs_see_stays() -> None:
    mesh, moved = refined_mesh(flat_wall(), [depth_of(across, 0.012) for across in NEAR[:2]])
    assert not moved.any() and np.array_equal(mesh.vertices, flat_wall().vertices)


def test_a_depth_far_from_the_surface_is_of_another() -> None:
    """A pixel is 10 mm on the wall; 50 mm are five of them."""
    _, moved = refined_mesh(flat_wall(), [depth_of(across, 0.05) for across in NEAR])
    assert not moved.any()


def test_of_a_step_in_the_depth_no_mean_is_taken() -> None:
    """The depths left of the middle of each picture are of the wall, right of it far in front: vertices go to one."""
    depth = np.full((480, 640), 4.99, np.float32)
    depth[:, 320:] = 4.0
    half = [DepthMap(camera_at(2.0), lambda: depth, Path())] * 3
    mesh, _ = refined_mesh(flat_wall(40), half)
    assert set(out_of(mesh).round(5).tolist()) == {0.0, 0.01}


def test_where_photographs_disagree_neighbours_go_alike() -> None:
    """Noise of half a pixel, 5 mm, each picture's own: a median of five has 2.7 mm of it. Where they agree on a step of
    10 mm it stays one."""
    random = np.random.default_rng(0)
    maps = []
    for across in NEAR:
        column = camera_at(across).project(on_wall(np.array([2.02]), np.array([1.5])).astype(np.float32))[0][
            0, 0
        ]
        depth = np.full((480, 640), 5.0, np.float32)
        depth[:, np.arange(640) + 0.5 > column] = 4.99
        depth[240:] += random.normal(0, 0.005, (240, 640)).astype(np.float32)
        maps.append(DepthMap(camera_at(across), partial(np.copy, depth), Path()))
    mesh, moved = refined_mesh(flat_wall(100), maps)
    places = mesh.vertices - FOOT
    across, up, out = places @ RIGHT, places @ UP, out_of(mesh)
    inside = moved & (abs(across - 2) < 0.9)
    noisy, sharp = inside & (up < 1.4), inside & (up > 1.6)
    left, right = across < 1.9, across > 2.1
    assert out[noisy & left].std() < 0.0015 and out[noisy & left].mean() == pytest.approx(0, abs=0.0005)
    assert out[sharp & (across < 1.99)] == pytest.approx(0, abs=0.0006)
    assert out[sharp & (across > 2.05)] == pytest.approx(0.01, abs=0.0006)
    assert out[noisy & right].mean() == pytest.approx(0.01, abs=0.0005)


def test_depths_between_pixels_are_interpolated() -> None:
    """A wall that leans: its depth grows by a 25th of a pixel's size from column to column."""
    column = np.arange(640, dtype=np.float32)
    leaning: Float32 = np.repeat((5.0 + 0.0004 * (column - 319.5))[None], 480, axis=0).astype(np.float32)
    mesh, moved = refined_mesh(flat_wall(), [DepthMap(camera_at(2.0), lambda: leaning, Path())] * 3)
    across = (flat_wall().vertices - FOOT) @ RIGHT
    expected = -0.0004 * (across - 2) * 500 / 5
    near = moved & (abs(across - 2) < 0.7) & (abs((flat_wall().vertices - FOOT) @ UP - 1.5) < 0.8)
    assert near.sum() > 50
    assert out_of(mesh)[near] == pytest.approx(expected[near], abs=2e-5)


def test_faces_do_not_turn_over() -> None:
    """Faces of 8 mm, of which one corner is said to be 35 mm out: it stays."""
    wall = flat_wall()
    small = replace(wall, vertices=(0.04 * (wall.vertices - FOOT) + on_wall(np.array(2.0), np.array(1.5))))
    small = replace(small, vertices=small.vertices.astype(np.float32))
    depth = np.full((480, 640), 5.0, np.float32)
    pixels, _ = camera_at(2.0).project(small.vertices[[220]])
    column, row = np.floor(pixels[0]).astype(int)
    depth[row, column] = 4.965
    mesh, moved = refined_mesh(small, [DepthMap(camera_at(2.0), lambda: depth, Path())] * 3)
    assert abs(out_of(mesh)).max() < 0.01 and not moved.all()


def ramp() -> Mesh:
    """Return a wall with faces of 20 cm, whose right half is 30 mm out: a ramp in the column between."""
    wall = flat_wall()
    out = np.where((wall.vertices - FOOT) @ RIGHT > 2.05, 0.03, 0.0)
    return replace(wall, vertices=(wall.vertices + out[:, None] * NORMAL).astype(np.float32))


def maps_of_a_step() -> list[DepthMap]:
    """Return depth maps that show the step where it is, 2.06 m across."""
    maps = []
    for across in NEAR:
        at = camera_at(across).project(on_wall(np.array([2.06]), np.array([1.5])).astype(np.float32))[0][0, 0]
        depth = np.full((480, 640), 5.0, np.float32)
        depth[:, np.arange(640) + 0.5 > at] = 4.97
        maps.append(DepthMap(camera_at(across), partial(np.copy, depth), Path()))
    return maps


@pytest.mark.parametrize(("faces", "made"), [(0, 800), (800, 800), (1100, 1100), (10_000, 1150)])
def test_there_are_more_faces_where_the_surface_bends(
    faces: int, made: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At most as many more as simplification leaves out, and none of what is flat, or where no depth map tells more."""
    monkeypatch.setattr(refined, "depth_maps", lambda _: maps_of_a_step())
    write_mesh(tmp_path / "mesh.ply", ramp())
    surface = refine_surface(tmp_path / "mesh.ply", tmp_path, faces)
    mesh = read_mesh(tmp_path / "mesh.ply")
    assert len(mesh.faces) == surface.faces and 0.9 * made < surface.faces <= made
    monkeypatch.setattr(refined, "depth_maps", lambda _: [])
    write_mesh(tmp_path / "mesh.ply", ramp())
    assert refine_surface(tmp_path / "mesh.ply", tmp_path, faces).faces == 800


def test_a_step_is_steeper_with_more_faces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refined, "depth_maps", lambda _: maps_of_a_step())
    widths = []
    for faces in (800, 1333):
        write_mesh(tmp_path / "mesh.ply", ramp())
        refine_surface(tmp_path / "mesh.ply", tmp_path, faces)
        mesh = read_mesh(tmp_path / "mesh.ply")
        level = np.ptp(out_of(mesh)[mesh.faces], axis=1) < 0.005
        near = abs((mesh.middles - FOOT) @ UP - 1.5) < 0.8
        corners = ((mesh.corners() - FOOT) @ RIGHT)[~level & near]
        widths.append(float(np.ptp(corners)))
    assert widths[0] == pytest.approx(0.2, abs=0.01)
    assert widths[1] < 0.13


def test_neighbours_go_alike_less_across_a_bend() -> None:
    """The right half of a wall is 10 mm farther out than the left; then it is at an angle to it besides."""
    apart = []
    for lift in (0.0, 1.0):
        wall = flat_wall()
        right = (wall.vertices - FOOT) @ RIGHT > 2.05
        out = np.where(right, lift * ((wall.vertices - FOOT) @ RIGHT - 2.0), 0.0)
        mesh = replace(wall, vertices=(wall.vertices + out[:, None] * NORMAL).astype(np.float32))
        normals = vertex_normals(mesh).astype(np.float64)
        step = np.where(right, 0.01, 0.0).astype(np.float32)
        smooth = refined._alike(step, np.full(len(step), 4, np.float32), mesh, normals, SILENT)
        beside = abs((wall.vertices - FOOT) @ RIGHT - 2.1) < 0.15
        apart.append(float(smooth[right & beside].mean() - smooth[~right & beside].mean()))
    assert apart[1] > 1.1 * apart[0]
