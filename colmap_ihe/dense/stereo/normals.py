"""Compute the surface normals of a depth map."""

from __future__ import annotations

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float32, Float64
from colmap_ihe.dense.stereo.strips import overwrite, strips

# A window beside a pixel is taken where its misfit is so much less than that of the window around it: beside an edge
# it is less by orders of magnitude, on a surface only by chance.
_CLEARLY_LESS = 0.95
_AWAY = 1.7  # how far such a window's middle is from the pixel, in half windows: depth right beside an edge is poor
# Where the misfit is more than so many times the usual one, as between two edges, a window of half the size is taken if
# its misfit is less than a seventh.
_UNUSUAL, _SMALLER, _MUCH_LESS = 3.0, 1 / 2, 0.15
_MEDIAN_PX = 5  # of the depth that planes are fitted to, since depth beside edges has outliers
_Offset = tuple[int, int]


def normals_from_inverse_depth(inverse_depth: Float32, K: Float64, radius_px: int) -> Float32:
    """Return unit normals (H, W, 3) float32 in the camera frame, towards the camera; 0 where there is no depth.

    `inverse_depth` (H, W) float32, 0 for none; `K` (3, 3). The inverse depth of a plane n.X = c is the
    affine function n.(x, y, 1) / c of the normalised pixel, so a plane is fitted by least squares in a
    window of 2 `radius_px` + 1 pixels. Of the window around a pixel and eight beside it, the one whose plane, continued
    to the pixel, fits best is taken, so that windows do not reach across edges; between edges also smaller ones.
    """
    smooth = _without_outliers(inverse_depth)
    slope_x, slope_y, misfit = best_slopes(smooth, radius_px, round(_AWAY * radius_px))
    fitted = np.isfinite(misfit) & (inverse_depth > 0)
    if fitted.any():
        small = round(_SMALLER * radius_px)
        small_x, small_y, small_misfit = best_slopes(smooth, small, small)
        unusual = misfit > _UNUSUAL * np.median(misfit[fitted])
        better = unusual & (small_misfit < _MUCH_LESS * misfit)
        overwrite(slope_x, small_x, better)
        overwrite(slope_y, small_y, better)
    return normals_from_slopes(inverse_depth, slope_x, slope_y, K)


def _without_outliers(inverse_depth: Float32) -> Float32:
    """Return the median of a small window, where all of it has a depth; elsewhere what is there."""
    median = np.asarray(cv2.medianBlur(inverse_depth, _MEDIAN_PX), np.float32)
    around = np.ones((_MEDIAN_PX, _MEDIAN_PX), np.uint8)
    held = (inverse_depth > 0).astype(np.uint8)
    whole = cv2.erode(held, around, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    return np.where(whole, median, inverse_depth)


def normals_from_slopes(inverse_depth: Float32, slope_x: Float32, slope_y: Float32, K: Float64) -> Float32:
    """Return unit normals (H, W, 3) float32 as `normals_from_inverse_depth` does, from the slopes (H, W) of inverse
    depth by column and row."""
    slope_x, slope_y = slope_x * np.float32(K[0, 0]), slope_y * np.float32(K[1, 1])
    height, width = inverse_depth.shape
    x = ((np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]).astype(np.float32)[None, :]
    y = ((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1]).astype(np.float32)[:, None]
    normals = np.empty((height, width, 3), np.float32)
    for strip in strips(inverse_depth.shape):
        own = strip.own
        rest = inverse_depth[own] - slope_x[own] * x - slope_y[own] * y[own]
        away = (slope_x[own], slope_y[own], rest)  # from the camera
        length = np.sqrt(away[0] * away[0] + away[1] * away[1] + away[2] * away[2])
        sound = (inverse_depth[own] > 0) & (length > 0)
        scale = np.where(sound, -1 / np.where(sound, length, 1), 0).astype(np.float32)
        for axis, values in enumerate(away):
            np.multiply(values, scale, out=normals[own, :, axis])
    return normals


def best_slopes(inverse_depth: Float32, radius_px: int, away_px: int) -> tuple[Float32, Float32, Float32]:
    """Return per pixel the slopes of inverse depth by column and row, and the misfit, of the window that fits it best;
    windows beside it have their middle `away_px` columns and rows away."""
    mean, slope_x, slope_y, misfit = fitted_planes(inverse_depth, radius_px)
    best = misfit * np.float32(_CLEARLY_LESS)
    offsets = [(x, y) for y in (-away_px, 0, away_px) for x in (-away_px, 0, away_px) if x or y]
    best_x, best_y = slope_x.copy(), slope_y.copy()
    for strip in strips(inverse_depth.shape):
        for offset in offsets:
            of_pixels, of_windows = _overlap(inverse_depth.shape, offset, strip.own)
            here = mean[of_windows] - slope_x[of_windows] * offset[0] - slope_y[of_windows] * offset[1]
            worst = np.maximum(misfit[of_windows], np.square(inverse_depth[of_pixels] - here))
            better = worst < best[of_pixels]
            overwrite(best[of_pixels], worst, better)
            overwrite(best_x[of_pixels], slope_x[of_windows], better)
            overwrite(best_y[of_pixels], slope_y[of_windows], better)
    return best_x, best_y, best


def fitted_planes(inverse_depth: Float32, radius_px: int) -> tuple[Float32, Float32, Float32, Float32]:
    """Return of the window around each pixel the fitted plane, as its value there and its slopes by column and row, and
    its mean square misfit, infinite where no plane can be fitted."""
    held = (inverse_depth > 0).astype(np.float32)
    ones = np.ones((2 * radius_px + 1, 1), np.float32)
    count = np.maximum(_moment(held, ones, ones), 1)
    sums = [
        operator(
            inverse_depth, cv2.CV_64F, (len(ones), len(ones)), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        for operator in (cv2.boxFilter, cv2.sqrBoxFilter)
    ]
    planes = np.empty((4, *held.shape), np.float32)
    for strip in strips(held.shape, radius_px):
        given = [values[strip.seen] for values in (inverse_depth, held, count, *sums)]
        planes[:, strip.own] = [values[strip.inner] for values in _planes(radius_px, *given)]
    return planes[0], planes[1], planes[2], planes[3]


def _planes(
    radius_px: int, inverse_depth: Float32, held: Float32, count: Float32, total: Float64, squares: Float64
) -> tuple[Float32, Float32, Float32, Float32]:
    """Do as `fitted_planes` does, from where there are depths, and of each window their count, sum and sum of squares;
    these are float64, as the variance is a millionth of the square."""
    mean, square = total / count, squares / count
    mean_w = mean.astype(np.float32)
    variance = np.maximum(square - mean * mean, 0).astype(np.float32)
    first = np.arange(-radius_px, radius_px + 1, dtype=np.float32)[:, None]
    ones, second, moment = np.ones_like(first), first * first, _moment
    mean_x, mean_y = moment(held, first, ones) / count, moment(held, ones, first) / count
    xx = moment(held, second, ones) / count - mean_x * mean_x
    yy = moment(held, ones, second) / count - mean_y * mean_y
    xy = moment(held, first, first) / count - mean_x * mean_y
    xw = moment(inverse_depth, first, ones) / count - mean_x * mean_w
    yw = moment(inverse_depth, ones, first) / count - mean_y * mean_w
    determinant = xx * yy - xy * xy
    usable = determinant > 0.05
    safe = np.where(usable, determinant, 1)
    slope_x: Float32 = np.where(usable, (xw * yy - yw * xy) / safe, 0)
    slope_y: Float32 = np.where(usable, (yw * xx - xw * xy) / safe, 0)
    misfit = np.maximum(variance - slope_x * xw - slope_y * yw, 0)
    full = usable & (count > (2 * radius_px + 1) ** 2 / 3)
    value = np.asarray(mean_w - slope_x * mean_x - slope_y * mean_y, np.float32)
    return value, slope_x, slope_y, np.where(full, misfit, np.inf).astype(np.float32)


def _moment(image: Float32, x: Float32, y: Float32) -> Float32:
    """Return (H, W) float32, sums over the window around each pixel, by weights of its columns and rows."""
    sums = cv2.sepFilter2D(image, cv2.CV_32F, x, y, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums, np.float32)


def _overlap(
    shape: tuple[int, ...], offset: _Offset, rows: slice
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the slices of the pixels of some rows of an image and of those `offset` (columns, rows) away, where both
    are inside."""
    x, y = offset
    first, left = max(rows.start, -y), max(0, -x)
    last, right = max(first, min(rows.stop, shape[0] - y)), max(left, shape[1] - max(0, x))
    return (slice(first, last), slice(left, right)), (slice(first + y, last + y), slice(left + x, right + x))
