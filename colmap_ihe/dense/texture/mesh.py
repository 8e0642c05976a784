"""Hold a triangle mesh with vertex colours, and find its connected parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int32, Int64, UInt8

_SHORT = 1e-150  # its square is still a number


@dataclass(frozen=True)
class Mesh:
    """Hold `vertices` (V, 3) float32, `faces` (F, 3) int32 of their rows, anticlockwise from outside, and `colours`
    (V, 3) uint8 RGB, gamma-coded as in the photographs. Raises ValueError for other shapes, or for faces of missing
    vertices."""

    vertices: Float32
    faces: Int32
    colours: UInt8

    def __post_init__(self) -> None:
        for name in ("vertices", "faces", "colours"):
            shape = getattr(self, name).shape
            if len(shape) != 2 or shape[1] != 3:
                raise ValueError(f"{name}.shape={shape}, expected (N, 3)")
        if len(self.colours) != len(self.vertices):
            raise ValueError(f"{len(self.colours)} colours of {len(self.vertices)} vertices")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise ValueError(
                f"a face has a corner that does not exist: {self.faces.max()} of {len(self.vertices)}"
            )

    def corners(self) -> Float32:
        """Return (F, 3, 3) float32, the corners of each face."""
        return self.vertices[self.faces]

    @cached_property
    def middles(self) -> Float32:
        """Return (F, 3) float32, the middle of each face."""
        return np.asarray(self.corners().mean(axis=1))

    @cached_property
    def normals(self) -> Float64:
        """Return (F, 3) float64, the normals of the faces, each as long as twice the area of its face."""
        return face_normals(self.corners())

    def with_faces(self, chosen: Bool) -> Mesh:
        """Return only the faces where `chosen` (F,) is true, and the vertices that they need."""
        faces = self.faces[chosen]
        used = np.zeros(len(self.vertices), bool)
        used[faces] = True
        row = (np.cumsum(used) - 1).astype(np.int32)
        return Mesh(self.vertices[used], row[faces], self.colours[used])


def face_normals(corners: Float32) -> Float64:
    """Return the normals (F, 3) float64 of corners (F, 3, 3), each as long as twice the area of its face."""
    corners = corners.astype(np.float64)
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def vertex_normals(mesh: Mesh) -> Float32:
    """Return (V, 3) float32, each of length one: the mean of the faces around each vertex, by area. Where these have no
    area or cancel out it is the mean of the neighbouring vertices, and where there is none either (0, 0, 1)."""
    normals = mesh.normals
    unit = _unit(_summed(mesh, [normals] * 3))
    corners = unit[mesh.faces]
    around = corners.sum(axis=1, keepdims=True) - corners
    lost = ~unit.any(axis=1)
    unit[lost] = _unit(_summed(mesh, [around[:, k] for k in range(3)]))[lost]
    unit[~unit.any(axis=1)] = (0, 0, 1)
    return np.asarray(unit, np.float32)


def _summed(mesh: Mesh, of_corners: Sequence[Float64]) -> Float64:
    """Return (V, 3): the sums at each vertex of what its faces have at their first, second and third corner, (F, 3)
    each."""
    total = np.zeros((len(mesh.vertices), 3))
    for k, values in enumerate(of_corners):
        for axis in range(3):
            total[:, axis] += np.bincount(mesh.faces[:, k], values[:, axis], len(total))
    return total


def _unit(vectors: Float64) -> Float64:
    """Return (N, 3) of length one, zero where they are too short to have a direction."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.where(length > _SHORT, vectors / np.maximum(length, _SHORT), 0.0))


def neighbours(faces: Int32) -> Int64:
    """Return (E, 2), the pairs of faces that share an edge. An edge of more than two faces joins them in a chain."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    key = edges[:, 0] * (int(faces.max(initial=0)) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    return np.stack((order[same] // 3, order[same + 1] // 3), axis=1)


def components(count: int, pairs: npt.NDArray[np.integer[Any]]) -> Int64:
    """Return (count,): the same number for items that `pairs` (E, 2) connect, from 0 up without gaps.

    Each root is hung below the smallest root it meets, then paths are halved, until nothing changes
    (Shiloach and Vishkin 1982).
    """
    parent = np.arange(count, dtype=np.int64)
    first, second = pairs[:, 0], pairs[:, 1]
    while True:
        open_pairs = parent[first] != parent[second]
        if not open_pairs.any():
            break
        first, second = first[open_pairs], second[open_pairs]
        roots = parent[first], parent[second]
        np.minimum.at(parent, np.maximum(*roots), np.minimum(*roots))
        while not np.array_equal(up := parent[parent], parent):
            parent = up
    return np.asarray(np.unique(parent, return_inverse=True)[1]).reshape(-1)


def without_small_parts(mesh: Mesh, share: float, least_area: float = 0.0) -> Mesh:
    """Remove the connected parts whose area is less than `share` of that of the largest, or than `least_area`;
    the largest stays."""
    if not len(mesh.faces):
        return mesh
    part = components(len(mesh.vertices), mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2))[mesh.faces[:, 0]]
    area = np.bincount(part, np.linalg.norm(mesh.normals, axis=1)) / 2
    return mesh.with_faces(area[part] >= min(max(share * area.max(), least_area), area.max()))
