"""Split the faces of a mesh where it bends, so that there are more of them at edges than on walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Bool, Float64, Int64
from colmap_ihe.dense.texture.mesh import Mesh, neighbours

_LEAST_BEND = 0.1  # radians to a neighbour, below which a surface is flat
_CORNERS = np.arange(3)


@dataclass(frozen=True)
class _Sides:
    """Hold the sides of a mesh's faces: `ends` (E, 2), the vertices of each; `of_face` (F, 3), the sides from each
    corner to the next; `faces` (E,), how many faces each has."""

    ends: Int64
    of_face: Int64
    faces: Int64


def split_where_bent(mesh: Mesh, most: int) -> Mesh:
    """Return `mesh` with up to `most` faces: those are split in four that bend most from a neighbour for their size,
    and their neighbours in as many as keep the surface without gaps. Its shape stays. Vertices keep their rows, and
    new ones, in the middles of sides, follow."""
    if not len(mesh.faces) or most <= len(mesh.faces):
        return mesh
    sides = _sides_of(mesh)
    split = _chosen(_bend(mesh), sides, most - len(mesh.faces))
    first, second = sides.ends[split].T
    vertices = (mesh.vertices[first] + mesh.vertices[second]) / 2
    colours = (mesh.colours[first].astype(np.uint16) + mesh.colours[second]) // 2
    middle = np.full(len(split), -1, np.int64)
    middle[split] = len(mesh.vertices) + np.arange(len(vertices))
    return Mesh(
        np.concatenate((mesh.vertices, vertices)),
        _in_parts(mesh.faces.astype(np.int64), middle[sides.of_face]).astype(np.int32),
        np.concatenate((mesh.colours, colours.astype(np.uint8))),
    )


def _sides_of(mesh: Mesh) -> _Sides:
    faces = mesh.faces.astype(np.int64)
    ends = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=2), axis=2)
    count = len(mesh.vertices)
    key, number, times = np.unique(
        ends[..., 0] * count + ends[..., 1], return_inverse=True, return_counts=True
    )
    return _Sides(np.stack(np.divmod(key, count), axis=1), number.reshape(faces.shape), times)


def _bend(mesh: Mesh) -> Float64:
    """Return (F,), the largest angle of each face to a neighbour times its longest side, zero where it is flat."""
    pairs = neighbours(mesh.faces)
    normals = mesh.normals / np.maximum(np.linalg.norm(mesh.normals, axis=1, keepdims=True), 1e-300)
    angle = np.arccos(np.clip((normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1), -1, 1))
    largest = np.zeros(len(normals))
    for column in pairs.T:
        np.maximum.at(largest, column, angle)
    corners = mesh.corners().astype(np.float64)
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    return np.where(largest < _LEAST_BEND, 0.0, largest * longest)


def _chosen(bend: Float64, sides: _Sides, room: int) -> Bool:
    """Return which sides (E,) are split: all three of each face from the most bent on, while there is `room` for the
    faces that this makes. A side that is split makes one more of each of its faces."""
    rank = np.empty(len(bend), np.int64)
    rank[np.argsort(-bend, kind="stable")] = np.arange(len(bend))
    bent = int(np.count_nonzero(bend))
    best = np.full(len(sides.ends), len(bend), np.int64)
    np.minimum.at(best, sides.of_face.ravel(), np.repeat(rank, 3))
    made = np.cumsum(np.bincount(best, sides.faces, len(bend) + 1))
    last = min(bent, int(np.searchsorted(made, room, "right")))
    return np.asarray(best < last)


def _in_parts(faces: Int64, middle: Int64) -> Int64:
    """Return (N, 3): faces (F, 3) in parts, with `middle` (F, 3), the vertices in the middles of the sides from each
    corner to the next, -1 for a side that is not split."""
    split = middle >= 0
    count = split.sum(axis=1)
    whole, halved, cut, quartered = (np.flatnonzero(count == k) for k in range(4))
    parts = [faces[whole]]
    (a, b, c), (m, _, _) = _turned(faces, middle, halved, split[halved].argmax(axis=1))
    parts += [_faces(a, m, c), _faces(m, b, c)]
    (a, b, c), (_, m, n) = _turned(faces, middle, cut, split[cut].argmin(axis=1))
    parts += [_faces(a, b, m), _faces(a, m, n), _faces(n, m, c)]
    (a, b, c), (m, n, o) = faces[quartered].T, middle[quartered].T
    parts += [_faces(a, m, o), _faces(m, b, n), _faces(o, n, c), _faces(m, n, o)]
    return np.concatenate(parts)


def _turned(faces: Int64, middle: Int64, rows: Int64, first: Int64) -> tuple[Int64, Int64]:
    """Return (3, N) corners and (3, N) middles of some faces, beginning with the corner `first` (N,)."""
    order = (first[:, None] + _CORNERS) % 3
    return faces[rows[:, None], order].T, middle[rows[:, None], order].T


def _faces(a: Int64, b: Int64, c: Int64) -> Int64:
    return np.stack((a, b, c), axis=1)
