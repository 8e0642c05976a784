"""Triangles to pixels: who covers which pixel centre, and who is in front.

Pixels are COLMAP's: the centre of the top left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.texture.mesh import F32, F64, I64, Bool

_CHUNK = 2_000_000  # candidate pixels at a time: about 200 MB
_INSIDE = -1e-6  # of barycentric coordinates, so that no pixel falls between two triangles


@dataclass(frozen=True)
class TextureView:
    """A pinhole camera: `calibration` K (3, 3), `cam_from_world` (3, 4), `size` (width, height)."""

    calibration: F64
    cam_from_world: F64
    size: tuple[int, int]

    @property
    def centre(self) -> F64:
        """(3,): where it stands."""
        return np.asarray(-self.cam_from_world[:, :3].T @ self.cam_from_world[:, 3])

    def project(self, points: F32) -> tuple[F64, F64]:
        """Of (..., 3) points: pixels (..., 2), and depths (...) along the axis. Where the depth is not positive,
        pixels are nan."""
        seen = points.astype(np.float64) @ self.cam_from_world[:, :3].T + self.cam_from_world[:, 3]
        depth = seen[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (seen @ self.calibration.T)[..., :2] / depth[..., None]
        return np.where((depth > 0)[..., None], pixels, np.nan), depth


@dataclass(frozen=True)
class Covered:
    """Pixel centres in triangles: `pixel` (N,) row-major numbers, `face` (N,) rows of the triangles, `weights`
    (N, 3) float64 barycentric coordinates."""

    pixel: I64
    face: I64
    weights: F64


def covered(corners: F64, size: tuple[int, int]) -> Iterator[Covered]:
    """Every pixel centre of a picture of `size` (width, height) in every triangle of `corners` (F, 3, 2), in
    parts. Triangles with a corner that is not finite, or without area, cover nothing."""
    width, height = size
    sound: Bool = np.asarray(np.isfinite(corners).all(axis=(1, 2)))
    bounded = np.clip(np.where(sound[:, None, None], corners, 0), -1e6, 1e6)
    low = np.clip(np.ceil(bounded.min(axis=1) - 0.5), 0, (width, height)).astype(np.int64)
    high = np.clip(np.floor(bounded.max(axis=1) - 0.5) + 1, 0, (width, height)).astype(np.int64)
    span = np.maximum(high - low, 0) * sound[:, None]
    count = span[:, 0] * span[:, 1]
    faces = np.flatnonzero(count)
    ends = np.cumsum(count[faces])
    start = 0
    while start < len(faces):
        before = ends[start - 1] if start else 0
        end = max(int(np.searchsorted(ends, before + _CHUNK, "right")), start + 1)
        yield _inside(corners, faces[start:end], low, span, count, width)
        start = end


def _inside(corners: F64, faces: I64, low: I64, span: I64, count: I64, width: int) -> Covered:
    """Of the pixels in the boxes of `faces`, those inside the triangles."""
    face = np.repeat(faces, count[faces])
    starts = np.repeat(np.cumsum(count[faces]) - count[faces], count[faces])
    place = np.arange(len(face)) - starts
    row, column = np.divmod(place, span[face, 0])
    column, row = column + low[face, 0], row + low[face, 1]
    a, b, c = (corners[:, k] for k in range(3))
    double_area = _cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(double_area == 0, np.nan, 1 / double_area)[face]
    point = np.stack((column + 0.5, row + 0.5), axis=1) - a[face]
    second = _cross(point, (c - a)[face]) * scale
    third = _cross((b - a)[face], point) * scale
    first = 1 - second - third
    inside = (first >= _INSIDE) & (second >= _INSIDE) & (third >= _INSIDE)
    weights = np.stack((first[inside], second[inside], third[inside]), axis=1)
    return Covered((row * width + column)[inside], face[inside], weights)


def _cross(one: F64, other: F64) -> F64:
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def depth_picture(pixels: F64, depths: F64, size: tuple[int, int]) -> F32:
    """(H, W) float32: the depth of the nearest triangle at each pixel centre, infinite where there is none.

    `pixels` (F, 3, 2) and `depths` (F, 3) are the corners in a view; 1 / depth is linear on the picture.
    """
    inverse = np.zeros(size[0] * size[1], np.float32)
    with np.errstate(divide="ignore"):
        corner_inverse = 1 / depths
    for part in covered(pixels, size):
        value = (corner_inverse[part.face] * part.weights).sum(axis=1).astype(np.float32)
        np.maximum.at(inverse, part.pixel, value)
    with np.errstate(divide="ignore"):
        return np.asarray(1 / inverse, np.float32).reshape(size[1], size[0])
