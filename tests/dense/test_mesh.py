"""The surface of clouds of known shape."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import StopsWhen

from colmap_ihe.dense import mesh as surface
from colmap_ihe.dense.ply import Rows, read_mesh, read_ply, write_mesh, write_rows
from colmap_ihe.dense.texture.mesh import Mesh, face_normals
from colmap_ihe.errors import Cancelled, MappingError, NativeError, ProjectError
from colmap_ihe.machine.progress import Progress

_FIELDS = [
    *((n, "<f4") for n in ["x", "y", "z", "nx", "ny", "nz"]),
    *((n, "u1") for n in ("red", "green", "blue")),
]


def cloud_of(positions: object, normals: object, colours: object) -> Rows:
    values = np.column_stack([np.asarray(positions, float), np.asarray(normals, float), np.asarray(colours)])
    return np.asarray(np.rec.fromarrays(list(values.T), dtype=_FIELDS)).view(_FIELDS)


def sphere(count: int = 20_000, radius: float = 1.0, centre: tuple[float, float, float] = (0, 0, 0)) -> Rows:
    """Red where x is positive, blue elsewhere."""
    normals = np.random.default_rng(1).normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colours = np.where(normals[:, :1] > 0, [200, 20, 20], [20, 20, 200])
    return cloud_of(radius * normals + centre, normals, colours)


def meshed(folder: Path, faces: int = 1000, **more: Any) -> surface.Surface:
    return surface.reconstruct_surface(folder / "cloud.ply", folder / "mesh.ply", faces, **more)


@pytest.mark.parametrize("scale", [0.01, 1000.0])
def test_a_sphere_of_any_size(tmp_path: Path, scale: float) -> None:
    write_rows(tmp_path / "cloud.ply", sphere(radius=scale))
    result = meshed(tmp_path, 1500)
    mesh = read_mesh(tmp_path / "mesh.ply")
    assert len(mesh.faces) == result.faces
    assert 1400 < result.faces <= 1500 < result.faces_before < 8 * 1500
    radii = np.linalg.norm(mesh.vertices, axis=1) / scale
    assert 0.98 < radii.min() <= radii.max() < 1.02
    assert (mesh.vertices[mesh.colours[:, 0] > mesh.colours[:, 2], 0] > -0.1 * scale).all()
    outwards = (face_normals(mesh.corners()) * mesh.corners().mean(axis=1)).sum(axis=1) > 0
    assert outwards.mean() > 0.99
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud.ply", "mesh.ply"]


def test_simplification_leaves_room_for_more_faces(tmp_path: Path) -> None:
    """The octree is as deep as for all faces."""
    write_rows(tmp_path / "cloud.ply", sphere())
    whole, less = meshed(tmp_path, 1500), meshed(tmp_path, 1500, simplified=0.6)
    assert 850 < less.faces <= 900 and less.depth == whole.depth and less.faces_before == whole.faces_before


def test_what_floats_is_removed_and_holes_stay_open(tmp_path: Path) -> None:
    dome = sphere()
    speck = sphere(2000, radius=0.02, centre=(0, 0, -2))
    write_rows(tmp_path / "cloud.ply", np.concatenate([dome[dome["z"] > 0.2], speck]))
    meshed(tmp_path, 2000)
    z = read_mesh(tmp_path / "mesh.ply").vertices[:, 2]
    assert -0.1 < z.min() < 0.25


@pytest.mark.parametrize(
    "points",
    [
        *(sphere(0), sphere(1), sphere(99), sphere(500, radius=0.0)),
        cloud_of(np.full((500, 3), np.nan), np.ones((500, 3)), np.zeros((500, 3))),
        cloud_of(np.random.default_rng(0).random((500, 3)), np.zeros((500, 3)), np.zeros((500, 3))),
    ],
    ids=["empty", "one", "few", "all at one place", "not numbers", "no normals"],
)
def test_a_cloud_that_gives_no_surface(tmp_path: Path, points: Rows) -> None:
    write_rows(tmp_path / "cloud.ply", points)
    with pytest.raises(MappingError, match="a surface needs 100 points") as caught:
        meshed(tmp_path)
    assert "--no-mesh" in caught.value.hint
    assert not (tmp_path / "mesh.ply").exists()


def test_a_trim_that_leaves_nothing(tmp_path: Path) -> None:
    write_rows(tmp_path / "cloud.ply", sphere())
    with pytest.raises(MappingError, match="no surface is dense enough"):
        meshed(tmp_path, options={"trim": 40.0})


def abort(_job: object, _progress: Progress) -> None:
    os.abort()


def sleep(_job: object, _progress: Progress) -> None:
    time.sleep(60)


def test_colmap_may_abort(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_rows(tmp_path / "cloud.ply", sphere())
    monkeypatch.setattr(surface, "_meshed", abort)
    with pytest.raises(NativeError, match=r"Poisson meshing: COLMAP died \(SIGABRT\)") as caught:
        meshed(tmp_path)
    assert "--no-mesh" in caught.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["cloud.ply"]


def test_it_stops_when_asked_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_rows(tmp_path / "cloud.ply", sphere())
    monkeypatch.setattr(surface, "_meshed", sleep)
    end = time.monotonic() + 0.5
    with pytest.raises(Cancelled):
        meshed(tmp_path, progress=StopsWhen(lambda _: time.monotonic() > end))
    assert [p.name for p in tmp_path.iterdir()] == ["cloud.ply"]


def test_mesh_files_go_round(tmp_path: Path) -> None:
    mesh = Mesh(
        np.random.default_rng(0).random((5, 3), np.float32),
        np.array([[0, 1, 2], [2, 3, 4]], np.int32),
        np.arange(15, dtype=np.uint8).reshape(5, 3),
    )
    write_mesh(tmp_path / "mesh.ply", mesh)
    again = read_mesh(tmp_path / "mesh.ply")
    assert np.array_equal(again.vertices, mesh.vertices)
    assert np.array_equal(again.faces, mesh.faces)
    assert np.array_equal(again.colours, mesh.colours)
    content = (tmp_path / "mesh.ply").read_bytes()
    for broken in (b"", content[:-1], content[:60], content.replace(b"binary_little", b"binary_big")):
        (tmp_path / "broken.ply").write_bytes(broken)
        with pytest.raises(ProjectError, match="cannot be read as a binary PLY file"):
            read_ply(tmp_path / "broken.ply")


def test_the_cells_of_all_depths_are_counted_at_once() -> None:
    points = np.random.default_rng(3).normal(size=(4000, 3)).astype(np.float32) * (4, 2, 0.1)
    points = points.astype(np.float32)
    expected = {
        depth: len(np.unique(surface._cells(points, surface._cells_per_unit(points, depth))))
        for depth in (5, 8, 13)
    }
    counted = surface._occupied(points)
    assert {depth: counted[depth] for depth in expected} == expected
    assert expected[5] < expected[8] < expected[13]
