"""Compute the surface normals of a depth map."""

from __future__ import annotations

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float32, Float64


def normals_from_inverse_depth(inverse_depth: Float32, K: Float64, radius_px: int) -> Float32:
    """Return unit normals (H, W, 3) float32 in the camera frame, towards the camera; 0 where there is no depth.

    `inverse_depth` (H, W) float32, 0 for none; `K` (3, 3). The inverse depth of a plane n.X = c is the
    affine function n.(x, y, 1) / c of the normalised pixel, so a plane is fitted by least squares in a
    window of 2 `radius_px` + 1 pixels, whose sums cost the same at every radius in each direction.
    """
    held = (inverse_depth > 0).astype(np.float32)
    offsets = np.arange(-radius_px, radius_px + 1, dtype=np.float32)[:, None]
    ones, first, second = np.ones_like(offsets), offsets, offsets * offsets

    def moment(image: Float32, x: Float32, y: Float32) -> Float32:
        sums = cv2.sepFilter2D(image, cv2.CV_32F, x, y, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(sums, np.float32)

    count = np.maximum(moment(held, ones, ones), 1)
    mean_x, mean_y = moment(held, first, ones) / count, moment(held, ones, first) / count
    mean_w = moment(inverse_depth, ones, ones) / count
    xx = moment(held, second, ones) / count - mean_x * mean_x
    yy = moment(held, ones, second) / count - mean_y * mean_y
    xy = moment(held, first, first) / count - mean_x * mean_y
    xw = moment(inverse_depth, first, ones) / count - mean_x * mean_w
    yw = moment(inverse_depth, ones, first) / count - mean_y * mean_w
    determinant = xx * yy - xy * xy
    usable = determinant > 0.05
    safe = np.where(usable, determinant, 1)
    slope_x = np.where(usable, (xw * yy - yw * xy) / safe, 0) * np.float32(K[0, 0])
    slope_y = np.where(usable, (yw * xx - xw * xy) / safe, 0) * np.float32(K[1, 1])
    height, width = inverse_depth.shape
    x = ((np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]).astype(np.float32)[None, :]
    y = ((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1]).astype(np.float32)[:, None]
    # (slope_x, slope_y, rest) points away from the camera.
    away = np.stack([slope_x, slope_y, inverse_depth - slope_x * x - slope_y * y], axis=-1)
    length = np.sqrt(np.square(away).sum(axis=-1))
    sound = (inverse_depth > 0) & (length > 0)
    scale = np.where(sound, -1 / np.where(sound, length, 1), 0).astype(np.float32)
    return np.asarray(away * scale[..., None], np.float32)
