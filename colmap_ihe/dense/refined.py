"""Move the vertices of a mesh to where the depth maps of the photographs say that the surface is.

A mesh by Poisson and simplification is smoother than what the photographs measured, and the cloud that it comes from
keeps few of their depths at each place. Here each vertex goes along its normal to the weighted median of the depths,
and neighbours go alike where these disagree. Then faces are split where the surface bends, and vertices go once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int64, PinholeCamera
from colmap_ihe.dense.depth_maps import DepthMap, depth_maps
from colmap_ihe.dense.ply import read_mesh, write_mesh
from colmap_ihe.dense.split_faces import split_where_bent
from colmap_ihe.dense.texture.mesh import Mesh, face_normals, vertex_normals
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.files import replace_file
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers

SIMPLIFIED = 0.5
"""Of the faces of a mesh: those that simplification leaves. The others are made where it bends."""

_REACH = 4.0  # pixels of a photograph on the surface, beyond which a depth is of another surface
_FEWEST = 3  # photographs that must see a vertex there
_MOST = 16  # depths of a vertex that are kept: those that tell most
_LEAST_COSINE = 0.2  # between normal and ray
_SHARPEST = 0.05  # pixels between depths: less is no better
_ALIKE = 8.0
"""How much one neighbour counts, where a vertex counts by 1 / the square of the pixels between its depths."""
_BENT = 8  # power of the cosine between the normals of two neighbours, by which they count
_ROUNDS = 20  # in which neighbours become alike
_TURNED = 0.5  # cosine by which a face may turn at most
_CHUNK = 200_000  # vertices at a time


@dataclass(frozen=True)
class RefinedSurface:
    """Describe a mesh by its faces, and by the share of its vertices that depth maps moved, in percent."""

    faces: int
    moved_percent: float


def refine_surface(
    mesh: Path, dense_dir: Path, faces: int = 0, progress: Progress = SILENT
) -> RefinedSurface:
    """Move the vertices of the PLY file `mesh` to what the depth maps of a workspace `dense_dir` say, with up to
    `faces` faces where the surface bends. Raises `ProjectError` where a map cannot be read, `Cancelled`."""
    part = mesh.with_name(f".{mesh.stem}.refined.part.ply")
    maps = depth_maps(dense_dir)
    try:
        surface, moved = refined_mesh(read_mesh(mesh), maps, progress)
        most = min(faces, int(len(surface.faces) / SIMPLIFIED))
        if moved.any() and most > len(surface.faces):
            surface, moved = refined_mesh(split_where_bent(surface, most), maps, progress)
        write_mesh(part, surface)
        replace_file(part, mesh)
    finally:
        part.unlink(missing_ok=True)
    return RefinedSurface(len(surface.faces), 100 * float(moved.mean()) if len(moved) else 0.0)


def refined_mesh(mesh: Mesh, maps: Sequence[DepthMap], progress: Progress = SILENT) -> tuple[Mesh, Bool]:
    """Return `mesh` with its vertices at the weighted median of what three `maps` or more say near them, smoothed where
    they disagree, and which (V,) were moved. A depth counts by how straight and from how near it was seen. Vertices
    stay where faces would turn over. Raises `Cancelled`, and what the maps raise."""
    progress.start(len(maps), "depth maps compared with the surface")
    normals = vertex_normals(mesh).astype(np.float64)
    steps = np.full((_MOST, len(mesh.vertices)), np.nan, np.float32)
    weights = np.zeros_like(steps)

    def compare(depths: DepthMap) -> tuple[Int64, Float64, Float64]:
        return _steps(mesh.vertices, normals, depths.camera, depths.read())

    with ThreadPoolExecutor(local_workers()) as threads:
        for rows, step, weight in in_order(threads, compare, maps, progress=progress):
            _keep(steps, weights, rows, step, weight)
            progress.advance()
    median, trust = _medians(steps, weights)
    moved = np.isfinite(median)
    smooth = _alike(median, trust, mesh, normals, progress)
    vertices = mesh.vertices + (np.where(moved, smooth, 0)[:, None] * normals).astype(np.float32)
    moved &= ~_turned_over(mesh, vertices)
    vertices[~moved] = mesh.vertices[~moved]
    return replace(mesh, vertices=vertices), moved


def _steps(
    vertices: Float32, normals: Float64, camera: PinholeCamera, depth: Float32
) -> tuple[Int64, Float64, Float64]:
    """Return the rows of the vertices (V, 3) near which a depth map has a surface, how far along their normals it is,
    and how much that counts."""
    pixels, distance = camera.project(vertices)
    width, height = camera.size
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0.5).all(axis=1) & (pixels < (width - 0.5, height - 0.5)).all(axis=1)
    rows = np.flatnonzero(inside)
    pixels, distance = pixels[rows], distance[rows]
    ray = (vertices[rows] - camera.centre) / distance[:, None]
    along = (normals[rows] * ray).sum(axis=1)
    cosine = -along / np.linalg.norm(ray, axis=1)
    size = distance / float(camera.K[0, 0])
    measured = _depths_at(depth, pixels, _REACH * size)
    near = (measured > 0) & (np.abs(measured - distance) < _REACH * size) & (cosine > _LEAST_COSINE)
    step = (measured - distance) * along
    return rows[near], step[near], (cosine / size)[near] ** 2


def _depths_at(depth: Float32, pixels: Float64, apart: Float64) -> Float64:
    """Return (N,), the depths at pixels (N, 2): between the four around it where they are one surface, no more than
    `apart` (N,) from each other, else of the nearest."""
    height, width = depth.shape
    column, row = np.minimum(np.floor(pixels - 0.5).astype(np.int64), (width - 2, height - 2)).T
    right, down = pixels[:, 0] - 0.5 - column, pixels[:, 1] - 0.5 - row
    around = np.stack([depth[row + j, column + i] for j in (0, 1) for i in (0, 1)]).astype(np.float64)
    low, high = around.min(axis=0), around.max(axis=0)
    upper = around[0] + right * (around[1] - around[0])
    lower = around[2] + right * (around[3] - around[2])
    nearest = np.take_along_axis(around, (2 * (down >= 0.5) + (right >= 0.5))[None], axis=0)[0]
    return np.asarray(np.where((low > 0) & (high - low < apart), upper + down * (lower - upper), nearest))


def _keep(steps: Float32, weights: Float32, rows: Int64, step: Float64, weight: Float64) -> None:
    """Put the steps of a photograph in the places of those that count least, where they count more."""
    for start in range(0, len(rows), _CHUNK):
        part = slice(start, start + _CHUNK)
        slot = weights[:, rows[part]].argmin(axis=0)
        more = weight[part] > weights[slot, rows[part]]
        slot, chosen = slot[more], rows[part][more]
        steps[slot, chosen], weights[slot, chosen] = step[part][more], weight[part][more]


def _medians(steps: Float32, weights: Float32) -> tuple[Float32, Float32]:
    """Return (V,) float32, the weighted medians of steps (K, V), nan where there are fewer than `_FEWEST`, and (V,)
    float32, how much they are to be trusted: 1 / the square of how far off the steps are, the median in pixels."""
    median, trust = np.full((2, steps.shape[1]), np.nan, np.float32)
    for start in range(0, steps.shape[1], _CHUNK):
        rows = np.flatnonzero((weights[:, start : start + _CHUNK] > 0).sum(axis=0) >= _FEWEST) + start
        if not len(rows):
            continue
        step, weight = steps[:, rows], weights[:, rows]
        median[rows] = _weighted_median(step, weight)
        apart = np.abs(step - median[rows]) * np.sqrt(weight.max(axis=0))
        trust[rows] = 1 / (np.nanmedian(apart, axis=0) ** 2 + _SHARPEST**2)
    return median, trust


def _weighted_median(values: Float32, weights: Float32) -> Float32:
    order = np.argsort(values, axis=0)
    total = np.cumsum(np.take_along_axis(weights, order, axis=0), axis=0)
    half = (total >= total[-1] / 2).argmax(axis=0)
    row = np.take_along_axis(order, half[None], axis=0)
    return np.asarray(np.take_along_axis(values, row, axis=0)[0])


def _alike(step: Float32, trust: Float32, mesh: Mesh, normals: Float64, progress: Progress) -> Float64:
    """Return steps (V,) that are alike at neighbours, the more the less they are to be trusted, and the less the
    surface with its `normals` (V, 3) bends between them; nan stays."""
    sides = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    sides = sides[np.isfinite(step[sides]).all(axis=1)]
    count = len(step)
    keys = np.sort(sides[:, 0].astype(np.int64) * count + sides[:, 1])
    first, second = np.divmod(keys[np.flatnonzero(np.diff(keys, prepend=-1))], max(count, 1))
    cosine = np.clip((normals[first] * normals[second]).sum(axis=1), 0, 1)
    weight = _ALIKE * cosine**_BENT
    total = trust + np.bincount(first, weight, count) + np.bincount(second, weight, count)
    smooth = step.astype(np.float64)
    for _ in range(_ROUNDS):
        progress.check()
        around = np.bincount(first, weight * smooth[second], count)
        around += np.bincount(second, weight * smooth[first], count)
        smooth = (trust * step + around) / total
    return smooth


def _turned_over(mesh: Mesh, vertices: Float32) -> Bool:
    """Return (V,), true at the faces that would turn by more than 60 degrees with their corners at `vertices`, and
    those that would with the others back."""
    before = face_normals(mesh.corners())
    length = np.linalg.norm(before, axis=1)
    held = np.zeros(len(vertices), bool)
    while True:
        trial = np.where(held[:, None], mesh.vertices, vertices)
        after = face_normals(trial[mesh.faces])
        least = _TURNED * length * np.linalg.norm(after, axis=1)
        bad = ((before * after).sum(axis=1) < least) & ~held[mesh.faces].all(axis=1)
        if not bad.any():
            return held
        held[mesh.faces[bad]] = True
