"""A triangle mesh with vertex colours, and what belongs together in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Mesh:
    """`vertices` (V, 3) float32, `faces` (F, 3) int32 of their rows, anticlockwise from outside, `colours`
    (V, 3) uint8 RGB as the photographs have them. Raises ValueError for other shapes, or faces of vertices that
    are not there."""

    vertices: F32
    faces: I32
    colours: U8

    def __post_init__(self) -> None:
        for name in ("vertices", "faces", "colours"):
            shape = getattr(self, name).shape
            if len(shape) != 2 or shape[1] != 3:
                raise ValueError(f"{name}.shape={shape}, expected (N, 3)")
        if len(self.colours) != len(self.vertices):
            raise ValueError(f"{len(self.colours)} colours of {len(self.vertices)} vertices")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise ValueError(f"faces name vertices up to {self.faces.max()} of {len(self.vertices)}")

    def corners(self) -> F32:
        """(F, 3, 3) float32: the corners of each face."""
        return self.vertices[self.faces]

    def with_faces(self, chosen: Bool) -> Mesh:
        """Only the faces that `chosen` (F,) names, and the vertices that they need."""
        faces = self.faces[chosen]
        used = np.zeros(len(self.vertices), bool)
        used[faces] = True
        place = (np.cumsum(used) - 1).astype(np.int32)
        return Mesh(self.vertices[used], place[faces], self.colours[used])


def face_normals(corners: F32) -> F64:
    """(F, 3) float64 of (F, 3, 3): normals as long as twice the area of each face."""
    corners = corners.astype(np.float64)
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def vertex_normals(mesh: Mesh) -> F32:
    """(V, 3) float32 of length one: the mean of the faces around each vertex, by their area; zero where none is."""
    normals = face_normals(mesh.corners())
    total = np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(mesh.faces[:, k], normals[:, axis], len(total))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.maximum(length, 1e-300), np.float32)


def neighbours(faces: I32) -> I64:
    """(E, 2): the pairs of faces that share an edge. An edge of more than two faces joins them in a chain."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    key = edges[:, 0] * (int(faces.max(initial=0)) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    return np.stack((order[same] // 3, order[same + 1] // 3), axis=1)


def components(count: int, pairs: npt.NDArray[np.integer[Any]]) -> I64:
    """(count,): the same number for items that `pairs` (E, 2) connect, from 0 up without gaps.

    Each root is hung below the smallest root it meets, then paths are halved, until nothing changes
    (Shiloach and Vishkin 1982).
    """
    parent = np.arange(count, dtype=np.int64)
    first, second = pairs[:, 0], pairs[:, 1]
    while True:
        one, other = parent[first], parent[second]
        apart = one != other
        if not apart.any():
            break
        first, second, one, other = first[apart], second[apart], one[apart], other[apart]
        np.minimum.at(parent, np.maximum(one, other), np.minimum(one, other))
        while not np.array_equal(up := parent[parent], parent):
            parent = up
    return np.asarray(np.unique(parent, return_inverse=True)[1]).reshape(-1)


def without_small_parts(mesh: Mesh, share: float, least_area: float = 0.0) -> Mesh:
    """Without the connected parts whose area is less than `share` of that of the largest, or than `least_area`;
    the largest stays."""
    if not len(mesh.faces):
        return mesh
    part = components(len(mesh.vertices), mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2))[mesh.faces[:, 0]]
    area = np.bincount(part, np.linalg.norm(face_normals(mesh.corners()), axis=1)) / 2
    return mesh.with_faces(area[part] >= min(max(share * area.max(), least_area), area.max()))
