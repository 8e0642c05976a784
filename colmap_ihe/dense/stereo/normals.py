"""Compute the surface normals of a depth map."""

from __future__ import annotations

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float32, Float64

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
        slope_x, slope_y = np.where(better, small_x, slope_x), np.where(better, small_y, slope_y)
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
    # (slope_x, slope_y, rest) points away from the camera.
    away = np.stack([slope_x, slope_y, inverse_depth - slope_x * x - slope_y * y], axis=-1)
    length = np.sqrt(np.square(away).sum(axis=-1))
    sound = (inverse_depth > 0) & (length > 0)
    scale = np.where(sound, -1 / np.where(sound, length, 1), 0).astype(np.float32)
    return np.asarray(away * scale[..., None], np.float32)


def best_slopes(inverse_depth: Float32, radius_px: int, away_px: int) -> tuple[Float32, Float32, Float32]:
    """Return per pixel the slopes of inverse depth by column and row, and the misfit, of the window that fits it best;
    windows beside it have their middle `away_px` columns and rows away."""
    mean, slope_x, slope_y, misfit = fitted_planes(inverse_depth, radius_px)
    best = misfit * np.float32(_CLEARLY_LESS)
    away = np.zeros(inverse_depth.shape, np.int32)
    offsets = [(x, y) for y in (-away_px, 0, away_px) for x in (-away_px, 0, away_px) if x or y]
    for offset in offsets:
        of_pixels, of_windows = _overlap(inverse_depth.shape, offset)
        here = mean[of_windows] - slope_x[of_windows] * offset[0] - slope_y[of_windows] * offset[1]
        worst = np.maximum(misfit[of_windows], np.square(inverse_depth[of_pixels] - here))
        better = worst < best[of_pixels]
        best[of_pixels][better] = worst[better]
        away[of_pixels][better] = offset[1] * inverse_depth.shape[1] + offset[0]
    window = np.arange(inverse_depth.size, dtype=np.int32).reshape(inverse_depth.shape) + away
    return slope_x.ravel()[window], slope_y.ravel()[window], best


def fitted_planes(inverse_depth: Float32, radius_px: int) -> tuple[Float32, Float32, Float32, Float32]:
    """Return of the window around each pixel the fitted plane, as its value there and its slopes by column and row, and
    its mean square misfit, infinite where no plane can be fitted."""
    held = (inverse_depth > 0).astype(np.float32)
    offsets = np.arange(-radius_px, radius_px + 1, dtype=np.float32)[:, None]
    ones, first, second = np.ones_like(offsets), offsets, offsets * offsets

    def moment(image: Float32, x: Float32, y: Float32) -> Float32:
        sums = cv2.sepFilter2D(image, cv2.CV_32F, x, y, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(sums, np.float32)

    count = np.maximum(moment(held, ones, ones), 1)
    mean_x, mean_y = moment(held, first, ones) / count, moment(held, ones, first) / count
    mean_w, variance = _mean_and_variance(inverse_depth, count, radius_px)
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


def _mean_and_variance(image: Float32, count: Float32, radius_px: int) -> tuple[Float32, Float32]:
    """Return mean and variance of the `count` pixels that are not 0 in windows; summed in float64, as the variance is
    a millionth of the square."""
    side = 2 * radius_px + 1
    mean, square = (
        operator(image, cv2.CV_64F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT) / count
        for operator in (cv2.boxFilter, cv2.sqrBoxFilter)
    )
    return mean.astype(np.float32), np.maximum(square - mean * mean, 0).astype(np.float32)


def _overlap(shape: tuple[int, ...], offset: _Offset) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the slices of the pixels of an image and of those `offset` (columns, rows) away, where both are inside."""
    pixels, others = [], []
    for size, shift in zip(shape, reversed(offset), strict=True):
        pixels.append(slice(max(0, -shift), size - max(0, shift)))
        others.append(slice(max(0, shift), size - max(0, -shift)))
    return (pixels[0], pixels[1]), (others[0], others[1])
