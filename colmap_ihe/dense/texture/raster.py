"""Find the pixel centres that triangles cover, and the nearest triangle at each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int64

_CHUNK = 150_000  # candidate pixels at a time, which stay in the cache of a core
_INSIDE = -1e-6  # of barycentric coordinates, so that no pixel falls between two triangles


@dataclass(frozen=True)
class Covered:
    """Hold pixel centres in triangles: `pixel` (N,) row-major numbers, `face` (N,) rows of the triangles, `weights`
    (N, 3) barycentric coordinates."""

    pixel: npt.NDArray[np.integer[Any]]
    face: npt.NDArray[np.integer[Any]]
    weights: npt.NDArray[np.floating[Any]]


def covered(corners: Float64, size: tuple[int, int]) -> Iterator[Covered]:
    """Yield, in parts, every pixel centre of a picture of `size` (width, height) in every triangle of `corners`
    (F, 3, 2). Triangles with a corner that is not finite, or without area, cover nothing."""
    width, height = size
    sound: Bool = np.asarray(np.isfinite(corners).all(axis=(1, 2)))
    bounded = np.clip(np.where(sound[:, None, None], corners, 0), -1e6, 1e6)
    a, b, c = (bounded[:, k] for k in range(3))
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    low = np.clip(np.ceil(least - 0.5), 0, (width, height)).astype(np.int64)
    high = np.clip(np.floor(most - 0.5) + 1, 0, (width, height)).astype(np.int64)
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


def _inside(corners: Float64, faces: Int64, low: Int64, span: Int64, count: Int64, width: int) -> Covered:
    """Return those pixels in the boxes of `faces` that are inside the triangles."""
    number = np.repeat(np.arange(len(faces)), count[faces])
    starts = np.cumsum(count[faces]) - count[faces]
    row, column = np.divmod(np.arange(len(number)) - starts[number], span[faces, 0][number])
    column, row = column + low[faces, 0][number], row + low[faces, 1][number]
    a, b, c = (corners[faces, k] for k in range(3))
    double_area = _cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(double_area == 0, np.nan, 1 / double_area)[:, None]
        (b_x, b_y), (c_x, c_y) = ((b - a) * scale).T, ((c - a) * scale).T
    x, y = column + 0.5 - a[:, 0][number], row + 0.5 - a[:, 1][number]
    second = x * c_y[number] - y * c_x[number]
    third = b_x[number] * y - b_y[number] * x
    first = 1 - second - third
    inside = np.flatnonzero((first >= _INSIDE) & (second >= _INSIDE) & (third >= _INSIDE))
    weights = np.stack((first[inside], second[inside], third[inside]), axis=1)
    return Covered(row[inside] * width + column[inside], faces[number[inside]], weights)


def barycentric(a: Float64, b: Float64, c: Float64, point: Float64) -> Float64:
    """Return (N, 3), the barycentric coordinates of points (N, 2) in triangles of corners `a`, `b`, `c` (N, 2), not
    finite in triangles without area."""
    with np.errstate(divide="ignore", invalid="ignore"):
        second = _cross(point - a, c - a) / _cross(b - a, c - a)
        third = _cross(b - a, point - a) / _cross(b - a, c - a)
        return np.stack((1 - second - third, second, third), axis=1)


def areas(corners: Float64) -> Float64:
    """Return (F,), the areas of triangles of `corners` (F, 3, 2)."""
    return np.abs(_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])) / 2


def _cross(a: Float64, b: Float64) -> Float64:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def depth_picture(pixels: Float64, depths: Float64, size: tuple[int, int]) -> Float32:
    """Return (H, W) float32: the depth of the nearest triangle at each pixel centre, infinite where there is none.

    `pixels` (F, 3, 2) and `depths` (F, 3) are the corners in a view; 1 / depth is linear on the picture.
    """
    inverse = np.zeros(size[0] * size[1], np.float32)
    with np.errstate(divide="ignore"):
        corner_inverse = 1 / depths
    for part in covered(pixels, size):
        value = np.einsum("nk,nk->n", corner_inverse[part.face], part.weights).astype(np.float32)
        np.maximum.at(inverse, part.pixel, value)
    with np.errstate(divide="ignore"):
        return np.asarray(1 / inverse, np.float32).reshape(size[1], size[0])
