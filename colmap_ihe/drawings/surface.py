"""Find what of a mesh is seen on a drawing: for each pixel the nearest face, and how far out of the plane it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int32, Int64
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.dense.texture.raster import covered
from colmap_ihe.drawings.frames import DrawingFrame
from colmap_ihe.drawings.grid import PixelGrid

_TILE = 1024  # pixels a side, in which faces are looked for at a time


@dataclass(frozen=True)
class DrawnFaces:
    """Hold the faces of a mesh in the frame of a drawing: `corners` (N, 3, 3) float64 across, up and out; `face` (N,)
    their rows in the mesh, since a cylinder shows some twice."""

    corners: Float64
    face: Int64


@dataclass(frozen=True)
class SeenSurface:
    """Hold what each pixel shows: `out` (H, W) float32, nan where there is nothing, and `row` (H, W) int32, the row in
    `DrawnFaces`, -1 there."""

    out: Float32
    row: Int32


def drawn_faces(mesh: Mesh, frame: DrawingFrame, behind: float, before: float) -> DrawnFaces:
    """Return the faces of a mesh that are not all farther than `behind` behind the drawing or than `before` in front of
    it. Faces of which the drawing shows the back are left out."""
    corners = frame.to_drawing(mesh.vertices.astype(np.float64))[mesh.faces]
    turn = float(frame.turn)
    if np.isfinite(turn):
        corners[..., 0] -= turn * np.round((corners[..., 0] - corners[:, :1, 0]) / turn)
    near = (corners[..., 2].max(axis=1) >= -behind) & (corners[..., 2].min(axis=1) <= before)
    rows = np.flatnonzero(near & _faces_out(corners))
    corners = corners[rows]
    if not np.isfinite(turn):
        return DrawnFaces(corners, rows)
    low, high = corners[..., 0].min(axis=1), corners[..., 0].max(axis=1)
    over = [np.flatnonzero(high > turn / 2), np.flatnonzero(low < -turn / 2)]
    moved = [corners[part] + (shift, 0, 0) for part, shift in zip(over, (-turn, turn), strict=True)]
    return DrawnFaces(np.concatenate([corners, *moved]), rows[np.concatenate([np.arange(len(rows)), *over])])


def _faces_out(corners: Float64) -> Bool:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] > 0)


def seen_surface(faces: DrawnFaces, grid: PixelGrid, behind: float, before: float) -> SeenSurface:
    """Return what is seen on the pixels of `grid`: of the faces there the one farthest out, but none beyond `behind` or
    `before` of the drawing."""
    out = np.full((grid.height, grid.width), np.nan, np.float32)
    row = np.full((grid.height, grid.width), -1, np.int32)
    pixels = grid.pixels(faces.corners)
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    for top in range(0, grid.height, _TILE):
        in_rows = np.flatnonzero((high[:, 1] > top) & (low[:, 1] < top + _TILE))
        for left in range(0, grid.width, _TILE):
            within = (high[in_rows, 0] > left) & (low[in_rows, 0] < left + _TILE)
            rows = in_rows[within]
            part = np.s_[top : top + _TILE, left : left + _TILE]
            _fill(faces, rows, pixels[rows] - (left, top), out[part], row[part], (behind, before))
    return SeenSurface(out, row)


def _fill(
    faces: DrawnFaces,
    rows: Int64,
    pixels: Float64,
    out: Float32,
    row: Int32,
    limits: tuple[float, float],
) -> None:
    """Fill one tile, views `out` and `row` of it, with the nearest of the faces `rows`."""
    height, width = out.shape
    farthest = np.full(height * width, -np.inf, np.float32)
    nearest = np.full(height * width, -1, np.int32)
    corner_out = faces.corners[rows, :, 2]
    for part in covered(pixels, (width, height)):
        value = (corner_out[part.face] * part.weights).sum(axis=1).astype(np.float32)
        within = np.flatnonzero((value >= -limits[0]) & (value <= limits[1]))
        pixel, value = part.pixel[within], value[within]
        np.maximum.at(farthest, pixel, value)
        first = value >= farthest[pixel]
        nearest[pixel[first]] = rows[part.face[within[first]]]
    found = nearest >= 0
    out.reshape(height, width)[...] = np.where(found, farthest, np.nan).reshape(height, width)
    row[...] = nearest.reshape(height, width)
