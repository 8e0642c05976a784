"""Choose the photograph that gives each face its colours: the best that sees it, in patches as large as possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Int32, Int64, PinholeCamera, UInt8
from colmap_ihe.dense.texture.mesh import Mesh, face_normals
from colmap_ihe.dense.texture.raster import areas, depth_picture

UNSEEN = -1
_KEPT = 6  # views a face may choose from
_LEAST_FACING = 0.15  # cosine between the normal and the ray to the camera
_BEHIND = 0.005  # relative depth behind the nearest surface at which something is hidden
_BEFORE = 0.02  # relative depth of a step: whatever is nearer than that stands in front of what is behind
_MARGIN_PX = 5  # side of the square in which such a step hides a face, since edges of a mesh are not exact
_NEIGHBOUR = 0.4  # what a neighbour with the same view is worth, as a natural logarithm of quality
_ROUNDS = 30
# Corners, middles of the sides and the centre of a face: the points that must all be seen.
_SAMPLES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3]]
)


@dataclass
class Candidates:
    """Hold the best views of each face so far: `view` (F, K) int32, `UNSEEN` where there is none, and `quality`
    (F, K) float32, zero there."""

    view: Int32
    quality: Float32

    @classmethod
    def none(cls, faces: int) -> Candidates:
        """Return candidates of a mesh of which no view has been added."""
        return cls(np.full((faces, _KEPT), UNSEEN, np.int32), np.zeros((faces, _KEPT), np.float32))

    def add(self, number: int, quality: Float32) -> None:
        """Add the view `number` with its `quality` (F,), zero where it does not see a face."""
        worst = np.argmin(self.quality, axis=1)
        rows = np.flatnonzero(quality > self.quality[np.arange(len(worst)), worst])
        self.view[rows, worst[rows]] = number
        self.quality[rows, worst[rows]] = quality[rows]


def quality_in(mesh: Mesh, view: PinholeCamera, mask: Callable[[], UInt8 | None] = lambda: None) -> Float32:
    """Return (F,) float32: how well `view` shows each face, zero where it does not: its area on the picture in
    pixels, times the cosine of the viewing angle. `mask()` (H, W) uint8 is 0 where the picture must not be used."""
    pixels, depths = view.project(mesh.vertices)
    corners = mesh.corners()
    normals = face_normals(corners)
    rays = view.centre - corners.mean(axis=1)
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(rays, axis=1)
    facing = (normals * rays).sum(axis=1) / np.maximum(lengths, 1e-30)
    shown = pixels[mesh.faces]
    area = areas(shown)
    possible = (facing > _LEAST_FACING) & (np.nan_to_num(area) > 0)
    quality = np.zeros(len(mesh.faces), np.float32)
    rows = np.flatnonzero(possible)
    nearest = depth_picture(shown, depths[mesh.faces], view.size)
    if (allowed := mask()) is not None:
        nearest[allowed == 0] = 0  # as if something stood right before the camera
    rows = rows[_seen(corners[rows], view, nearest)]
    quality[rows] = area[rows] * facing[rows]
    return quality


def _seen(corners: Float32, view: PinholeCamera, nearest: Float32) -> Bool:
    """Return (F,), true where all of a face is on the picture and nothing hides it.

    A sample is hidden where the farthest surface within a pixel is nearer, since depth changes within a pixel; or
    where anything close by is much nearer, since a silhouette in the mesh is a few pixels off that in the picture.
    """
    width, height = view.size
    farthest = cv2.dilate(nearest, np.ones((3, 3), np.uint8))
    closest = cv2.erode(nearest, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8))
    seen = np.ones(len(corners), bool)
    for weights in _SAMPLES:
        pixels, depth = view.project(np.einsum("k,fkc->fc", weights, corners))
        with np.errstate(invalid="ignore"):
            column, row = np.floor(pixels).T
            inside = (column >= 1) & (row >= 1) & (column < width - 1) & (row < height - 1)
        column, row = (np.where(inside, v, 0).astype(np.intp) for v in (column, row))
        seen &= inside & (depth < (1 + _BEHIND) * farthest[row, column])
        seen &= closest[row, column] > (1 - _BEFORE) * depth
    return seen


def choose(candidates: Candidates, pairs: Int64) -> Int32:
    """Return (F,) int32: the view of each face, `UNSEEN` where none sees it. `pairs` (E, 2) are neighbouring faces.

    Iterated conditional modes (Besag 1986): every face takes the view whose quality, with a bonus for each
    neighbour of the same view, is highest; half of the faces at a time, since all at once would swap for ever.
    """
    rows = np.arange(len(candidates.view))
    with np.errstate(divide="ignore"):
        value = np.log(candidates.quality.astype(np.float64))
    chosen = candidates.view[rows, np.argmax(value, axis=1)]
    face, neighbour = np.concatenate((pairs, pairs[:, ::-1])).T
    draw = np.random.default_rng(0)
    for _ in range(_ROUNDS):
        votes = [np.bincount(face, view[face] == chosen[neighbour], len(rows)) for view in candidates.view.T]
        agrees = np.stack(votes, axis=1)
        best = candidates.view[rows, np.argmax(value + _NEIGHBOUR * agrees, axis=1)]
        changes = (best != chosen) & (draw.random(len(rows)) < 0.5)
        if not (best != chosen).any():
            break
        chosen = np.where(changes, best, chosen)
    return _without_specks(candidates, chosen, face, neighbour)


def _without_specks(candidates: Candidates, chosen: Int32, face: Int64, neighbour: Int64) -> Int32:
    """Give a face that disagrees with all its neighbours the view of one of them, where that view sees it."""
    for _ in range(3):
        alone = np.bincount(face, chosen[face] == chosen[neighbour], len(chosen)) == 0
        rows = np.flatnonzero(alone[face] & (chosen[face] != UNSEEN) & (chosen[neighbour] != UNSEEN))
        rows = rows[(candidates.view[face[rows]] == chosen[neighbour[rows]][:, None]).any(axis=1)]
        chosen = chosen.copy()
        chosen[face[rows]] = chosen[neighbour[rows]]
    return chosen


def box_labels(mesh: Mesh, chosen: Int32, views: int) -> Int32:
    """Return `chosen` (F,), with faces that no photograph shows labelled by the side of a box that they face:
    `views` + 0 .. 5 for -x, -y, -z, x, y, z."""
    normals = face_normals(mesh.corners())
    axis = np.argmax(np.abs(normals), axis=1)
    side = axis + 3 * (normals[np.arange(len(axis)), axis] > 0)
    return np.where(chosen == UNSEEN, views + side, chosen).astype(np.int32)
