"""Find the views that show something else than the others where a face is, as a photograph that misses a thin thing."""

from __future__ import annotations

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float32, Float64, Int32, PinholeCamera, UInt8
from colmap_ihe.dense.texture.bake import sample
from colmap_ihe.dense.texture.median import median_of_known
from colmap_ihe.dense.texture.mesh import Mesh

_BLUR_PX = 1.5
_LEAST_VIEWS = 3  # of which two can agree against one
_MOST_LEVELS, _MOST_SPREAD = 40.0, 4.0  # from the median colour: in levels, and in the median of that


def centre_colours(mesh: Mesh, view: PinholeCamera, picture: UInt8) -> UInt8:
    """Return (F, 3) uint8, the colours of a picture (H, W, 3) around the centre of each face, where it shows it."""
    pixels, _ = view.project(mesh.middles)
    blurred = np.asarray(cv2.GaussianBlur(picture, (0, 0), _BLUR_PX), np.uint8)
    colours = sample(blurred, np.clip(np.nan_to_num(pixels), -1e6, 1e6))
    return np.asarray(np.rint(colours), np.uint8)


def doubted(quality: Float32, colour: UInt8) -> Float32:
    """Return `quality` (F, K), made negative for the views whose `colour` (F, K, 3) is far from the median of those of
    positive quality: what they show is in front of the face or behind it."""
    clear = quality > 0
    values = np.where(clear[..., None], colour.astype(np.float32), np.nan)
    result = quality.copy()
    rows = np.flatnonzero(clear.sum(axis=1) >= _LEAST_VIEWS)
    median = median_of_known(values[rows])[:, None]
    away = np.abs(values[rows] - median).max(axis=2)
    most = np.maximum(np.float32(_MOST_LEVELS), _MOST_SPREAD * median_of_known(away)[:, None])
    result[rows] = np.where(away > most, -quality[rows], quality[rows])
    return result


def agreed_colours(quality: Float32, colour: UInt8) -> Float32:
    """Return (F, 3) float32: the median colour of a face in the views of positive `quality` (F, K), whose `colour`
    (F, K, 3) is; NaN where less than three show it."""
    clear = quality > 0
    rows = np.flatnonzero(clear.sum(axis=1) >= _LEAST_VIEWS)
    result = np.full((len(quality), 3), np.nan, np.float32)
    values = np.where(clear[rows, :, None], colour[rows].astype(np.float32), np.nan)
    result[rows] = median_of_known(values)
    return result


def at_corners(faces: Int32, count: int, of_faces: Float32) -> Float64:
    """Return (`count`, 3) float64 for corners: the mean of what `of_faces` (F, 3) says of the `faces` (F, 3) around it,
    without those of NaN; NaN where there is none."""
    known = np.flatnonzero(np.isfinite(of_faces).all(axis=1))
    corners = faces[known].ravel()
    shares = np.bincount(corners, minlength=count)
    sums = [np.bincount(corners, np.repeat(values, 3), count) for values in of_faces[known].T]
    with np.errstate(invalid="ignore"):
        return np.asarray(np.stack(sums, axis=1) / shares[:, None])
