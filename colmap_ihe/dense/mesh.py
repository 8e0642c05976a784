"""Make a surface with vertex colours from the fused cloud: Poisson reconstruction, trimmed, then simplified.

Poisson's time and memory grow with points and cells, and where cells are larger than the distance of the points, most
points add nothing. So the depth of its octree is chosen for the expected number of faces, and the cloud thinned to
about one point for each half cell. That also makes its density alike everywhere, so that the trim, which COLMAP counts
in levels of the octree, means the same on every scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fast_simplification import simplify

from colmap_ihe.colmap.native import apply_options, called, pycolmap
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.dense.camera import Float32, Int32, Int64, UInt8
from colmap_ihe.dense.ply import COLOURS, Rows, columns, read_mesh, read_ply, write_mesh, write_rows
from colmap_ihe.dense.see_through import without_seen_through
from colmap_ihe.dense.texture.mesh import Mesh, without_small_parts
from colmap_ihe.errors import MappingError, NativeError
from colmap_ihe.machine.files import replace_file
from colmap_ihe.machine.progress import SILENT, Progress

_GAPS = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
_KD_TREE = 4  # FLANN's exact one, KDTreeSingleIndex

_NORMAL = ("nx", "ny", "nz")
_MIN_POINTS = 100
_DEPTHS = range(5, 14)
_SCALE = 1.1  # of Poisson's cube over the box of the points
_FINER = 4  # times as many faces as expected: simplification removes them where the surface is flat
_FACES_PER_CELL = 2.1
_LEVELS_TRIMMED = 2.0  # below the octree's depth; the surface then reaches three cells beyond the points
_CELLS_BEYOND = 2.1  # that it may reach at most, which the density alone does not bound
_SMALL_PART = 0.002  # of the area of the largest part
_SMALL_CELLS = 200  # the area of a small part in any case
_CUT_OFF_CELLS = 50  # that of one which only the cut parts from the rest, as the ball on a thin neck


@dataclass(frozen=True)
class Surface:
    """Describe how a mesh was made, for the record; `faces_before` simplification."""

    depth: int
    trim: float
    points_used: int
    faces_before: int
    faces: int


def reconstruct_surface(
    cloud: Path,
    mesh: Path,
    faces: int,
    options: Mapping[str, Any] | None = None,
    progress: Progress = SILENT,
    dense_dir: Path | None = None,
    simplified: float = 1.0,
) -> Surface:
    """Mesh the PLY file `cloud`, with normals and colours, to `mesh` with at most `faces` faces; simplification
    leaves the share `simplified` of them.

    `options` goes to pycolmap.PoissonMeshingOptions, over the values chosen for the cloud. What the depth maps of a
    workspace `dense_dir` see through is cut out. Raises `MappingError` where the points give no surface, `NativeError`.
    """
    progress.start(4, "parts of the surface")
    parts = [mesh.with_name(f".{mesh.stem}.{word}.part.ply") for word in ("cloud", "poisson")]
    try:
        with ColmapProcesses() as processes, ThreadPoolExecutor(1) as beside:
            processes.start(1, _meshed)  # which imports COLMAP while the cloud is read and thinned
            thin, native = _prepared(cloud, faces, options or {})
            write_rows(parts[0], thin)
            progress.advance()
            near = beside.submit(_tree, thin)
            _poisson(processes, parts[0], parts[1], native, progress)
        progress.advance()
        cell = 1 / _cells_per_unit(columns(thin, "xyz"), native.depth)
        surface = _trimmed(parts[1], near.result(), cell, dense_dir, progress)
        before = len(surface.faces)
        surface = _simplified(surface, round(simplified * faces), cell)
        surface = replace(surface, colours=_nearest_colours(surface.vertices, near.result(), thin))
        progress.advance()
        write_mesh(parts[1], surface)
        replace_file(parts[1], mesh)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)
    progress.advance()
    return Surface(native.depth, native.trim, len(thin), before, len(surface.faces))


def _prepared(
    cloud: Path, faces: int, options: Mapping[str, Any]
) -> tuple[Rows, pycolmap.PoissonMeshingOptions]:
    """Return the thinned points of a cloud, and how to mesh them. Raises `MappingError` where they are too few."""
    points = read_ply(cloud)["vertex"]
    sound = np.logical_or.reduce([points[name] != 0 for name in _NORMAL])
    for name in (*"xyz", *_NORMAL):
        sound &= np.isfinite(points[name])
    if not sound.all():
        points = points[sound]
    _require_points(len(points))
    depth = _depth(columns(points, "xyz"), faces)
    chosen = {"depth": depth, "trim": depth - _LEVELS_TRIMMED, "color": False}
    native = poisson_options({**chosen, **options})
    thin = thinned(points, 2 * _cells_per_unit(columns(points, "xyz"), native.depth))
    _require_points(len(thin))
    return thin, native


def poisson_options(values: Mapping[str, Any]) -> pycolmap.PoissonMeshingOptions:
    """Return pycolmap's options with `values` set. Raises `OptionError`."""
    return apply_options(pycolmap.PoissonMeshingOptions(), values, "mesh.colmap")


def thinned(points: Rows, cells_per_unit: float) -> Rows:
    """Return the mean position, normal and colour of the points in each cell of a grid; normals have length one."""
    key = _cells(columns(points, "xyz"), cells_per_unit)
    _, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    mean = np.empty(len(counts), points.dtype)
    for name in points.dtype.names or ():
        values = np.bincount(inverse, points[name]) / counts
        mean[name] = np.rint(values) if points.dtype[name].kind == "u" else values
    length = np.sqrt(sum(mean[name].astype(np.float64) ** 2 for name in _NORMAL))
    for name in _NORMAL:
        mean[name] /= np.maximum(length, 1e-6)
    return mean[length > 1e-6]


def _nearest_colours(vertices: Float32, near: cv2.flann.Index, points: Rows) -> UInt8:
    """Return (V, 3) uint8, the mean colour of the three `points` nearest to each vertex, which `near` finds."""
    rows, _ = _nearest(vertices, near, min(3, len(points)))
    return np.asarray(np.rint(columns(points, COLOURS)[rows].mean(axis=1)), np.uint8)


def _poisson(
    processes: ColmapProcesses,
    cloud: Path,
    mesh: Path,
    options: pycolmap.PoissonMeshingOptions,
    progress: Progress,
) -> None:
    """Run Poisson in a process of its own, which can be stopped; on some clouds it aborts its process."""
    try:
        processes.call(_meshed, (cloud, mesh, options.todict()), progress)
    except NativeError as error:
        raise NativeError(
            f"Poisson meshing: {error}",
            hint="too little memory or a degenerate cloud: try --set mesh.colmap.depth=8, or --no-mesh",
        ) from error


def _meshed(job: tuple[Path, Path, dict[str, Any]], _progress: Progress) -> None:
    cloud, mesh, options = job
    settings = pycolmap.PoissonMeshingOptions(**options)
    called(pycolmap.poisson_meshing, cloud, mesh, settings, progress=SILENT, cancellable=False)


def _require_points(count: int) -> None:
    if count < _MIN_POINTS:
        raise MappingError(
            f"a surface needs {_MIN_POINTS} points, the dense cloud has {count} distinct ones",
            hint="see the warnings of the dense stage, or leave the mesh out with --no-mesh",
        )


def _cells_per_unit(positions: Float32, depth: int) -> float:
    side = _SCALE * max(float(np.ptp(positions[:, axis])) for axis in range(3))
    return float(2**depth) / max(side, 1e-12)


def _cells(positions: Float32, cells_per_unit: float) -> Int64:
    """Return (N,) int64, the number of the cell of each point."""
    number = np.zeros(len(positions), np.int64)
    for axis in range(3):
        across = positions[:, axis]
        number = (number << 21) | ((across - across.min()) * cells_per_unit).astype(np.int64)
    return number


def _depth(positions: Float32, faces: int) -> int:
    """Return the depth of the deepest octree that gives at most `_FINER` times the expected faces, and whose cells
    hold two points on average."""
    limit = min(_FINER * faces / _FACES_PER_CELL, len(positions) / 2)
    occupied = _occupied(positions)
    depth = _DEPTHS[0]
    for deeper in _DEPTHS[1:]:
        if occupied[deeper] > limit:
            break
        depth = deeper
    return depth


def _occupied(positions: Float32) -> dict[int, int]:
    """Return how many cells hold points at each of `_DEPTHS`: sorted along Morton's curve, the points of a cell of any
    depth follow one another."""
    deepest = _DEPTHS[-1]
    scale = _cells_per_unit(positions, deepest)
    code = np.zeros(len(positions), np.int64)
    for axis in range(3):
        across = positions[:, axis]
        code |= _with_gaps(((across - across.min()) * scale).astype(np.int64)) << axis
    code.sort()
    differing = code[1:] ^ code[:-1]
    return {d: 1 + int(np.count_nonzero(differing >> (3 * (deepest - d)))) for d in _DEPTHS}


def _with_gaps(numbers: Int64) -> Int64:
    """Return numbers (N,) below 2^21 with two zeros before each of their bits: halves are moved apart, then halves of
    these, five times."""
    for shift, kept in _GAPS:
        numbers = (numbers | (numbers << shift)) & kept
    return numbers


def _trimmed(
    path: Path, near: cv2.flann.Index, cell: float, dense_dir: Path | None, progress: Progress
) -> Mesh:
    """Return Poisson's mesh without faces far from the points that `near` finds, without what is seen through, and
    without floating parts. Raises `MappingError`."""
    mesh = read_mesh(path) if path.is_file() else None
    if mesh is not None and len(mesh.faces):
        _, squared = _nearest(mesh.vertices, near, 1)
        close = squared[:, 0] <= (_CELLS_BEYOND * cell) ** 2
        mesh = mesh.with_faces(np.asarray(close[mesh.faces].all(axis=1)))
        mesh = without_small_parts(mesh, _SMALL_PART, _SMALL_CELLS * cell**2)
        if dense_dir is not None:
            cut = without_seen_through(mesh, dense_dir, progress)
            mesh = without_small_parts(cut, 0, _CUT_OFF_CELLS * cell**2)
    if mesh is None or not len(mesh.faces):
        raise MappingError(
            "no surface is dense enough to be kept",
            hint="try a lower trim, as --set mesh.colmap.trim=0, or leave the mesh out with --no-mesh",
        )
    return mesh


def _simplified(mesh: Mesh, faces: int, cell: float) -> Mesh:
    """Return `mesh` with about `faces` faces, fewer where it bends less, and without colours; `cell` is the size of a
    face, since the library's thresholds are in the units of the vertices."""
    if len(mesh.faces) <= faces:
        return mesh
    origin = mesh.vertices.mean(axis=0, dtype=np.float64)
    vertices, rows = simplify((mesh.vertices - origin) / cell, mesh.faces, target_count=faces)
    vertices = (vertices * cell + origin).astype(np.float32)
    return Mesh(vertices, rows.astype(np.int32), np.zeros((len(vertices), 3), np.uint8))


def _tree(points: Rows) -> cv2.flann.Index:
    """Return what finds the nearest of `points`."""
    return cv2.flann.Index(columns(points, "xyz"), {"algorithm": _KD_TREE})


def _nearest(vertices: Float32, near: cv2.flann.Index, count: int) -> tuple[Int32, Float32]:
    """Return (V, count), the rows of the points nearest to each vertex, and the squares of their distances."""
    rows, squared = near.knnSearch(vertices, count, params={"checks": -1})
    return np.asarray(rows, np.int32), np.asarray(squared, np.float32)
