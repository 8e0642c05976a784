"""Choose the photograph that gives each face its colours: the best that sees it, in patches as large as possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int32, Int64, PinholeCamera, UInt8
from colmap_ihe.dense.texture.labels import Choices, label_faces
from colmap_ihe.dense.texture.mesh import Mesh, face_normals
from colmap_ihe.dense.texture.raster import areas, depth_picture

UNSEEN = -1
_KEPT = 12  # views a face may choose from
_LEAST_FACING = 0.15  # cosine between the normal and the ray to the camera
_BEHIND = 0.005  # relative depth behind the nearest surface at which something is hidden
_BEFORE = 0.02  # relative depth of a step: whatever is nearer than that stands in front of what is behind
_MARGIN_PX = 5  # side of the square in which such a step hides a face, since edges of a mesh are not exact
_BESIDE_EDGE = 0.01  # what the quality of such a view counts, for a face that has another one or none
_LEAST_SIDE = 0.3  # cosine between the normal and the side of a box on which a face is laid
_SIDES = 3  # of a box that a face can look at
_LAID = 0.5  # cost of a picture for a face that it shows badly, where a side of a box shows all of it
_TURNED = 0.3  # cost of the side of a box, times the cosine that it has less than the best side
# Corners, middles of the sides and the centre of a face: the points that must all be seen.
_SAMPLES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3]]
)


@dataclass
class Candidates:
    """Hold the best views of each face so far: `view` (F, K) int32, `UNSEEN` where there is none, and `quality`
    (F, K) float32, zero there, and negative where a view shows the face beside an edge (see `quality_in`); `colour`
    (F, K, 3) uint8, what it shows there."""

    view: Int32
    quality: Float32
    colour: UInt8

    @classmethod
    def none(cls, faces: int) -> Candidates:
        """Return candidates of a mesh of which no view has been added."""
        shape = (faces, _KEPT)
        colour = np.zeros((*shape, 3), np.uint8)
        return cls(np.full(shape, UNSEEN, np.int32), np.zeros(shape, np.float32), colour)

    def add(self, number: int, quality: Float32, colour: UInt8) -> None:
        """Add the view `number` with its `quality` (F,) as `quality_in` returns it and its colours (F, 3)."""
        values = worth(self.quality)
        worst = np.argmin(values, axis=1)
        rows = np.flatnonzero(worth(quality) > values[np.arange(len(worst)), worst])
        self.view[rows, worst[rows]] = number
        self.quality[rows, worst[rows]] = quality[rows]
        self.colour[rows, worst[rows]] = colour[rows]


def quality_in(mesh: Mesh, view: PinholeCamera, mask: Callable[[], UInt8 | None] = lambda: None) -> Float32:
    """Return (F,) float32: how well `view` shows each face, zero where it does not: its area on the picture in
    pixels, times the cosine of the viewing angle.

    Negative where it shows the face, but edge-on, or so near to the edge of something in front that the photograph may
    show that instead. `mask()` (H, W) uint8 is 0 where the picture must not be used.
    """
    pixels, depths = view.project(mesh.vertices)
    rays = view.centre - mesh.middles
    lengths = np.linalg.norm(mesh.normals, axis=1) * np.linalg.norm(rays, axis=1)
    facing = (mesh.normals * rays).sum(axis=1) / np.maximum(lengths, 1e-30)
    shown = pixels[mesh.faces]
    area = areas(shown)
    possible = (facing > 0) & (np.nan_to_num(area) > 0)
    quality = np.zeros(len(mesh.faces), np.float32)
    rows = np.flatnonzero(possible)
    nearest = depth_picture(shown, depths[mesh.faces], view.size)
    if (allowed := mask()) is not None:
        nearest[allowed == 0] = 0  # as if something stood right before the camera
    seen, clear = _seen(view.homogeneous(mesh.vertices)[mesh.faces[rows]], view.size, nearest)
    clear &= facing[rows] > _LEAST_FACING
    quality[rows] = np.where(clear, 1, -1) * np.where(seen, area[rows] * facing[rows], 0)
    return quality


def worth(quality: Float32) -> Float32:
    """Return by what views are compared: the quality, and little of it beside an edge."""
    return np.where(quality < 0, np.float32(-_BESIDE_EDGE) * quality, quality)


def _seen(corners: Float64, size: tuple[int, int], nearest: Float32) -> tuple[Bool, Bool]:
    """Return (F,), true where all of a face is on the picture and nothing hides it, and (F,), true where besides
    nothing in front is near; `corners` (F, 3, 3) are homogeneous pixels.

    A sample is hidden where the farthest surface within a pixel is nearer, since depth changes within a pixel.
    Something in front is near where anything close by is much nearer, since a silhouette in the mesh is a few pixels
    off that in the picture.
    """
    width, height = size
    farthest = cv2.dilate(nearest, np.ones((3, 3), np.uint8)).ravel()
    closest = cv2.erode(nearest, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)).ravel()
    seen, clear = np.ones((2, len(corners)), bool)
    by_corner = np.ascontiguousarray(corners.transpose(2, 1, 0))
    for weights in _SAMPLES:
        # homogeneous pixels of a point in a face are the same mean of its corners' as the point
        across, down, depth = (sum(w * v for w, v in zip(weights, c, strict=True) if w) for c in by_corner)
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = np.floor(across / depth), np.floor(down / depth)
            inside = (depth > 0) & (column >= 1) & (row >= 1) & (column < width - 1) & (row < height - 1)
        place = np.where(inside, row * width + column, 0).astype(np.intp)
        seen &= inside & (depth < (1 + _BEHIND) * farthest[place])
        clear &= closest[place] > (1 - _BEFORE) * depth
    return seen, clear


def choose(
    candidates: Candidates, mesh: Mesh, pairs: Int64, views: Sequence[PinholeCamera]
) -> tuple[Int32, Bool]:
    """Return (F,) int32, the label of each face, and (F,), true where a photograph colours it.

    A label is the number of the view on whose picture the face is laid; above them 0 .. 5 are the sides of a box that
    it looks at: -x, -y, -z, x, y, z. A face that no view shows clear of edges has no photograph's colours, but is laid
    on the picture of its neighbours, so that it makes no patch of its own: where that view shows it, and a few such
    faces also where it does not, though they may be folded over others there. `pairs` (E, 2) are neighbouring faces.
    """
    clear = np.asarray((candidates.quality > 0).any(axis=1))
    choices = _choices(candidates, mesh, clear, len(views))
    labels = label_faces(choices, pairs)
    far = np.flatnonzero(~clear)[_far_from_picture(mesh.corners()[~clear], labels[~clear], views)]
    labels[far] = choices.label[far, choices.cost[far].argmin(axis=1)]
    return labels, clear


def _far_from_picture(corners: Float32, labels: Int32, views: Sequence[PinholeCamera]) -> Bool:
    """Return (N,), true where corners (N, 3, 3) are behind the camera of their label, or farther from its picture than
    half its size: there faces become too large for a texture."""
    far = np.zeros(len(labels), bool)
    for number in np.unique(labels[labels < len(views)]):
        rows = np.flatnonzero(labels == number)
        pixels, _ = views[number].project(corners[rows])
        far[rows] = ~(np.abs(pixels / views[number].size - 0.5) <= 1).all(axis=(1, 2))
    return far


def _choices(candidates: Candidates, mesh: Mesh, clear: Bool, views: int) -> Choices:
    """Return the labels that each face may have and their costs: natural logarithms of the best quality over theirs.

    A face without a `clear` view is laid on any picture at no cost, or on a side of a box.
    """
    value = worth(candidates.quality)
    order = np.argsort(-value, axis=1, kind="stable")
    label = np.take_along_axis(candidates.view, order, axis=1)
    value = np.take_along_axis(value, order, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = np.where(value > 0, np.log(value[:, :1]) - np.log(value), np.inf).astype(np.float32)
    rows = np.flatnonzero(~clear)
    cost[rows] = np.where(label[rows] == UNSEEN, np.inf, _LAID)
    label[rows, -_SIDES:], cost[rows, -_SIDES:] = _sides(mesh, rows, views)
    return Choices(label, cost, views + 6, ~clear, views)


def _sides(mesh: Mesh, rows: Int64, views: int) -> tuple[Int32, Float32]:
    """Return (N, 3) int32 and float32: labels of the sides of a box on which faces may be laid, and their costs."""
    normals = face_normals(mesh.vertices[mesh.faces[rows]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    cosine = np.abs(normals)
    best = cosine.max(axis=1, keepdims=True)
    possible = (cosine > _LEAST_SIDE) | (cosine == best)
    cost = np.where(possible, _TURNED * (best - cosine), np.inf)
    return (views + np.arange(3) + 3 * (normals > 0)).astype(np.int32), cost.astype(np.float32)
