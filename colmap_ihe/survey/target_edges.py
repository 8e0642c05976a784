"""Measure the outer black square of a coded target: points on its edges, lines through them, where its diagonals cross.

Pixels here are OpenCV's, the centre of the top left one is (0, 0), but for what `square_of` returns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.observations import F64

U8 = npt.NDArray[np.uint8]
F32 = npt.NDArray[np.float32]
Bend = Callable[[F64], F64]
"""Takes points (N, 2) of COLMAP's pixels to a plane in which straight lines are straight, or back."""

_MOST_POINTS, _FEWEST_POINTS = 96, 12  # along an edge
_CORNER_SHARE = 0.07  # of an edge, at each end, that is not looked at: corners are round
_STEP_PX = 0.25  # across an edge
_WIDEST_PX, _NARROWEST_PX = 6.0, 1.25  # to each side of an edge
_REACH_CELLS = 0.8  # no farther, for there the next edge begins
_WINDOW = 0.5  # of the reach: standard deviation of the weights across an edge
_ROUNDS, _FITS = 5, 4
_HALF_PIXEL = 0.5
_LEAST_RISE = 8.0  # levels from dark to bright, together
_LEAST_DEVIATION_PX = 0.01
# Of rendered targets: what the noise of edges does to the crossing, and what the blurred cells beside an edge do.
_NOISE, _BESIDE = 3.0, 0.35


@dataclass(frozen=True)
class Square:
    """Hold a measured square in COLMAP's pixels: `centre_px` (2,), `corners_px` (4, 2), the mean length of its sides,
    the deviation of the centre, and `off_px`: how far points on the edges are from straight lines, as an RMS."""

    centre_px: F64
    corners_px: F64
    side_px: float
    deviation_px: float
    off_px: float


@dataclass(frozen=True)
class _Edges:
    """Hold points (4, N, 2) on the four edges, their weights (4, N), 0 where no edge was seen, the standard deviation
    of the blur across the edges, and the width of the narrowest cell."""

    points: F64
    weights: F64
    blur_px: float
    cell_px: float


def square_of(grey: U8, corners: F64, cells: int, camera: pycolmap.Camera | None = None) -> Square | None:
    """Return the square near `corners` (4, 2) of a target with `cells` by `cells` black and white cells; None where the
    picture has no such dark square."""
    edges = None
    for _ in range(_ROUNDS):
        edges = _edge_points(grey, corners, cells)
        if edges is None:
            return None
        lines = _lines(edges.points, edges.weights)
        moved = _corners(lines)
        if not _is_near(moved, corners, cells):
            return None
        corners = moved
    assert edges is not None
    flatten, bend = _planes(camera)
    return _square(edges, flatten, bend)


def crossing(corners: F64) -> F64:
    """Return (2,): where the diagonals of a quadrangle (4, 2) cross."""
    ends = np.column_stack((corners, np.ones(4)))
    point = np.cross(np.cross(ends[0], ends[2]), np.cross(ends[1], ends[3]))
    return np.asarray(point[:2] / point[2])


def _edge_points(grey: U8, corners: F64, cells: int) -> _Edges | None:
    """Return points on the edges to a part of a pixel: the middle of the rise from dark to bright, along lines across
    each edge; None where the square leaves the picture or has an edge that is not seen."""
    ends = np.roll(corners, -1, axis=0)
    lengths = np.linalg.norm(ends - corners, axis=1)
    if lengths.min() < 4:
        return None
    along = (ends - corners) / lengths[:, None]
    outward = np.stack((along[:, 1], -along[:, 0]), axis=1)
    cell = _cell_widths(corners, outward, cells)
    reach = np.clip(_REACH_CELLS * cell, _NARROWEST_PX, _WIDEST_PX)
    count = int(np.clip(lengths.mean(), _FEWEST_POINTS, _MOST_POINTS))
    shares = np.linspace(_CORNER_SHARE, 1 - _CORNER_SHARE, count)
    base = corners[:, None] + shares[:, None] * (ends - corners)[:, None]
    across = np.arange(-reach.max(), reach.max() + _STEP_PX / 2, _STEP_PX)
    places = base[:, :, None] + across[:, None] * outward[:, None, None]
    values = _sampled(grey, places)
    if values is None:
        return None
    weights = np.exp(-0.5 * (across / (_WINDOW * reach[:, None])) ** 2) * (np.abs(across) <= reach[:, None])
    rise = np.maximum(np.gradient(values, axis=2), 0) * weights[:, None]
    total = rise.sum(axis=2)
    middle = (rise * across).sum(axis=2) / np.maximum(total, 1e-9)
    strong = total > np.maximum(0.3 * np.median(total, axis=1, keepdims=True), _LEAST_RISE)
    if strong.sum(axis=1).min() < count / 2:
        return None
    return _Edges(
        points=base + middle[:, :, None] * outward[:, None],
        weights=np.where(strong, total, 0),
        blur_px=_blur(rise, total, across, middle, reach),
        cell_px=float(cell.min()),
    )


def _cell_widths(corners: F64, outward: F64, cells: int) -> F64:
    """Return (4,): the width of the cells behind each edge."""
    middle = (corners + np.roll(corners, -1, axis=0)) / 2
    depth = -((np.roll(middle, 2, axis=0) - middle) * outward).sum(axis=1)
    return np.asarray(np.maximum(depth, 0) / cells)


def _blur(rise: F64, total: F64, across: F64, middle: F64, reach: F64) -> float:
    """Return the standard deviation of the blur: that of the rises, without the window in which they were seen."""
    moments = (rise * (across - middle[..., None]) ** 2).sum(axis=2) / np.maximum(total, 1e-9)
    windowed = np.median(moments, axis=1)
    inverse = 1 / np.maximum(windowed, 1e-3) - 1 / (_WINDOW * reach) ** 2
    return float(np.median(np.sqrt(1 / np.maximum(inverse, 1 / reach**2))))


def _sampled(grey: U8, places: F64) -> F64 | None:
    """Return the grey at places (..., 2), of the same shape, between pixels linearly; None if one is outside."""
    low, high = places.min(axis=(0, 1, 2)), places.max(axis=(0, 1, 2))
    if low.min() < 0 or high[0] > grey.shape[1] - 1 or high[1] > grey.shape[0] - 1:
        return None
    left, top = np.floor(low).astype(int)
    part = grey[top : int(high[1]) + 2, left : int(high[0]) + 2].astype(np.float32)
    local = (places - (left, top)).astype(np.float32).reshape(places.shape[0], -1, 2)
    values = cv2.remap(part, local[..., 0], local[..., 1], cv2.INTER_LINEAR)
    return np.asarray(values, np.float64).reshape(places.shape[:-1])


def _lines(points: F64, weights: F64) -> F64:
    """Return (4, 3): a line through the points (4, N, 2) of each edge, as (nx, ny, -distance) with a normal of length
    1. Points far from their line count less."""
    own, lines = weights, np.zeros((len(points), 3))
    for _ in range(_FITS):
        total = own.sum(axis=1)
        middle = (points * own[..., None]).sum(axis=1) / total[:, None]
        x, y = np.moveaxis(points - middle[:, None], 2, 0)
        xx, xy, yy = ((one * other * own).sum(axis=1) for one, other in ((x, x), (x, y), (y, y)))
        angle = 0.5 * np.arctan2(2 * xy, xx - yy)  # of the direction in which the points spread most
        normal = np.stack((-np.sin(angle), np.cos(angle)), axis=1)
        lines = np.column_stack((normal, -(normal * middle).sum(axis=1)))
        limit = 2 * np.maximum(_usual(_distances(points, lines), weights), 1e-6)
        own = weights / np.maximum(1, _distances(points, lines) / limit[:, None]) ** 2
    return lines


def _distances(points: F64, lines: F64) -> F64:
    """Return (4, N): how far points are from the lines of their edges."""
    return np.asarray(np.abs((points * lines[:, None, :2]).sum(axis=2) + lines[:, 2:]))


def _usual(distances: F64, weights: F64) -> F64:
    """Return (4,): the standard deviation of the distances on each edge, robustly, of points that have a weight."""
    counted = weights > 0
    ordered = np.sort(np.where(counted, distances, np.inf), axis=1)
    return np.asarray(1.4826 * ordered[np.arange(len(ordered)), counted.sum(axis=1) // 2])


def _corners(lines: F64) -> F64:
    """Return (4, 2): where each edge meets the one before; edge k begins at corner k."""
    points = np.cross(np.roll(lines, 1, axis=0), lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(points[:, :2] / points[:, 2:])


def _is_near(moved: F64, corners: F64, cells: int) -> bool:
    side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean()
    away = np.linalg.norm(moved - corners, axis=1)
    return bool(np.isfinite(moved).all() and away.max() < max(2.5, side / cells))


def _planes(camera: pycolmap.Camera | None) -> tuple[Bend, Bend]:
    """Return how to take the lens away from pixels, in a plane with pixels of about the same size, and how to put it
    back."""
    if camera is None:
        return (lambda pixels: pixels), (lambda pixels: pixels)
    focal = camera.mean_focal_length()

    def flatten(pixels: F64) -> F64:
        return np.asarray(camera.cam_from_img(pixels)) * focal

    def bend(plane: F64) -> F64:
        rays = np.column_stack((plane / focal, np.ones(len(plane))))
        return np.asarray(camera.img_from_cam(rays))

    return flatten, bend


def _square(edges: _Edges, flatten: Bend, bend: Bend) -> Square | None:
    shape = edges.points.shape
    flat = flatten(edges.points.reshape(-1, 2) + _HALF_PIXEL).reshape(shape)
    if not np.isfinite(flat).all():
        return None
    lines = _lines(flat, edges.weights)
    corners = _corners(lines)
    pixels = bend(np.vstack((corners, crossing(corners))))
    if not np.isfinite(pixels).all():
        return None
    usual = _usual(_distances(flat, lines), edges.weights)
    counts = (edges.weights > 0).sum(axis=1)
    noise = _NOISE * float(np.sqrt((usual**2 / counts).mean()))
    beside = _BESIDE * edges.blur_px**3 / edges.cell_px**2
    return Square(
        centre_px=pixels[4],
        corners_px=pixels[:4],
        side_px=float(np.linalg.norm(np.roll(pixels[:4], -1, axis=0) - pixels[:4], axis=1).mean()),
        deviation_px=max(_LEAST_DEVIATION_PX, float(np.hypot(noise, beside))),
        off_px=float(np.sqrt((usual**2).mean())),
    )
