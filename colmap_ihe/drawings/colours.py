"""Give each pixel of a drawing the colour of the photograph that shows its face best, levelled across seams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int64, UInt8
from colmap_ihe.dense.texture.atlas import Patches
from colmap_ihe.dense.texture.bake import sample
from colmap_ihe.dense.texture.raster import barycentric
from colmap_ihe.drawings.frames import DrawingFrame
from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.surface import DrawnFaces, SeenSurface

_CHUNK = 2_000_000  # pixels at a time: some 300 MB
_MARGIN = 4  # pixels about the part of a photograph that is used


@dataclass(frozen=True)
class Photograph:
    """Hold a photograph as it was taken: its name, `read`, which returns it as (H, W, 3) uint8 RGB; `project`, which
    returns (N, 2) pixels, nan where it does not show them, and (N,) depths of points (N, 3) of the model; and
    its focal length in pixels."""

    name: str
    read: Callable[[], UInt8]
    project: Callable[[Float64], tuple[Float64, Float64]]
    focal_px: float


@dataclass(frozen=True)
class PaintedSurface:
    """Hold a mesh with what colours it: `patches`, whose labels are rows of `photographs`; `offsets` (P, 3) float32,
    which level their colours, and `colours` (P, 3) float32 of corners that no photograph shows; of the corners of the
    patches both."""

    patches: Patches
    photographs: Sequence[Photograph]
    offsets: Float32
    colours: Float32

    def label(self, face: Int64) -> Int64:
        """Return (N,), the row of the photograph that colours each face (N,) of the mesh, -1 for none."""
        label = self.patches.label[self.patches.faces[face, 0]]
        return np.asarray(np.where(self.patches.coloured[face], label, -1))


@dataclass(frozen=True)
class Band:
    """Hold rows of a drawing: `rgb` (H, W, 3) uint8, `out` (H, W) float32, nan where there is no surface; and
    `by_photograph` (H, W), true where a photograph shows it."""

    rgb: UInt8
    out: Float32
    by_photograph: Bool


def paint(
    surface: PaintedSurface, faces: DrawnFaces, seen: SeenSurface, frame: DrawingFrame, grid: PixelGrid
) -> Band:
    """Return the colours of what is `seen` on the pixels of `grid`."""
    shape = seen.row.shape
    rgb = np.zeros((shape[0] * shape[1], 3), np.uint8)
    by_photograph = np.zeros(shape[0] * shape[1], bool)
    flat_row, flat_out = seen.row.ravel(), seen.out.ravel()
    covered = np.flatnonzero(flat_row >= 0)
    label = surface.label(faces.face[flat_row[covered]])
    for number in np.unique(label):
        photograph = surface.photographs[number] if number >= 0 else None
        picture = photograph.read() if photograph else None
        members = covered[label == number]
        for start in range(0, len(members), _CHUNK):
            pixel = members[start : start + _CHUNK]
            places = _places(pixel, flat_out, grid)
            corners, weights = _corners(surface, faces, flat_row[pixel], places)
            colours, shown = _vertex_colours(surface, corners, weights), np.zeros(len(pixel), bool)
            if photograph is not None and picture is not None:
                taken, shown = _from_photograph(photograph, picture, frame.to_model(places), grid.pixel)
                taken += (surface.offsets[corners[shown]] * weights[shown][..., None]).sum(axis=1)
                colours[shown] = taken
            rgb[pixel] = np.clip(np.rint(colours), 0, 255)
            by_photograph[pixel] = shown
    return Band(rgb.reshape(*shape, 3), seen.out, by_photograph.reshape(shape))


def _places(pixel: Int64, out: Float32, grid: PixelGrid) -> Float64:
    row, column = np.divmod(pixel, grid.width)
    return np.stack((grid.across()[column], grid.up()[row], out[pixel].astype(np.float64)), axis=1)


def _corners(
    surface: PaintedSurface, faces: DrawnFaces, rows: Int64, places: Float64
) -> tuple[Int64, Float32]:
    """Return (N, 3), the corners of the patches around each place, and (N, 3) float32, by how much each counts."""
    a, b, c = (faces.corners[rows, k, :2] for k in range(3))
    weights = np.clip(np.nan_to_num(barycentric(a, b, c, places[:, :2]), nan=1 / 3), 0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    return surface.patches.faces[faces.face[rows]].astype(np.int64), weights.astype(np.float32)


def _vertex_colours(surface: PaintedSurface, corners: Int64, weights: Float32) -> Float32:
    values = surface.colours[corners] + surface.offsets[corners]
    return np.asarray((values * weights[..., None]).sum(axis=1), np.float32)


def _from_photograph(
    photograph: Photograph, picture: UInt8, points: Float64, pixel: float
) -> tuple[Float32, Bool]:
    """Return (M, 3) float32, the colours of those of `points` (N, 3) that the picture shows, and which (N,) they are.
    Where the drawing's `pixel` is larger than the photograph's, they are means."""
    pixels, depths = photograph.project(points)
    height, width = picture.shape[:2]
    with np.errstate(invalid="ignore"):
        shown = np.asarray((pixels >= 0).all(axis=1) & (pixels <= (width, height)).all(axis=1) & (depths > 0))
    if not shown.any():
        return np.zeros((0, 3), np.float32), shown
    pixels = pixels[shown]
    scale = float(np.median(depths[shown])) / photograph.focal_px / pixel
    margin = int(_MARGIN / min(scale, 1.0))
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - margin, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + margin, (width, height))
    part = picture[low[1] : high[1], low[0] : high[0]]
    return sample(part, pixels - low, scale), shown
