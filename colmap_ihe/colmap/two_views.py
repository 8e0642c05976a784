"""Find features, matches and verified matches of two grey images as COLMAP does: arrays in, numbers out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.array_features import extract_arrays
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import SILENT, Progress

_MAX_RATIO, _MAX_ANGLE = 0.8, 0.7  # COLMAP's defaults; angles between descriptors in radians
_UNIT = 512.0  # the length of a descriptor that COLMAP has cut to 8 bit
_ROWS = 2048

Matches = NDArray[np.intp]
"""(N, 2): the feature in the first image, and that in the second."""


@dataclass(frozen=True)
class Features:
    """Hold the features of an image. `places`: (N, 2) float64, x and y in pixels, (0, 0) the corner of the first pixel.
    `scales`: (N,) float64, pixels. `descriptors`: (N, 128) uint8."""

    places: NDArray[np.float64]
    scales: NDArray[np.float64]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.places)


def features_of(
    images: Sequence[NDArray[np.uint8]], progress: Progress = SILENT, *, first_octave: int = -1
) -> list[Features]:
    """Return all SIFT features of each image, (H, W) uint8, by COLMAP on the CPU, one thread a core.

    `first_octave` 0 leaves out those smaller than two pixels, in a quarter of the time. The same images give the same
    features. Raises `NativeError`, `DiskFullError`, `Cancelled`, ValueError.
    """
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = max((max(grey.shape, default=1) for grey in images), default=1)
    options.sift.first_octave = first_octave
    options.sift.max_num_features = 1_000_000
    options.use_gpu = False
    return [_as_features(*each) for each in extract_arrays(images, options, "features of pairs", progress)]


def _as_features(keypoints: NDArray[np.float32], descriptors: NDArray[np.uint8]) -> Features:
    points = keypoints.astype(np.float64).reshape(-1, 6)
    # x, y, and the affine shape a11 a12 a21 a22, of which COLMAP takes the mean length of both axes
    scales = (np.hypot(points[:, 2], points[:, 4]) + np.hypot(points[:, 3], points[:, 5])) / 2
    return Features(points[:, :2], scales, descriptors)


def match(first: Features, second: Features) -> Matches:
    """Return mutual nearest neighbours that are much nearer than the second nearest, both ways, as COLMAP's matcher
    takes them by default."""
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.intp)
    a, b = (f.descriptors.astype(np.float32) / np.float32(_UNIT) for f in (first, second))
    back = _Nearest(len(b))
    forth = [_compared(a[begin : begin + _ROWS] @ b.T, begin, back) for begin in range(0, len(a), _ROWS)]
    nearest, passes = (np.concatenate(parts) for parts in zip(*forth, strict=True))
    rows = np.arange(len(a))
    kept = passes & back.passes[nearest] & (back.nearest[nearest] == rows)
    return np.stack((rows[kept], nearest[kept]), axis=1)


class _Nearest:
    """Hold the nearest so far of each feature, and how alike it and the second nearest are: cosines of angles."""

    def __init__(self, count: int) -> None:
        self.nearest = np.zeros(count, np.intp)
        self.best = np.full(count, -1, np.float32)
        self.next = np.full(count, -1, np.float32)

    def add(self, nearest: NDArray[np.intp], best: NDArray[np.float32], second: NDArray[np.float32]) -> None:
        self.next = np.maximum(np.maximum(self.next, second), np.minimum(self.best, best))
        self.nearest = np.where(best > self.best, nearest, self.nearest)
        self.best = np.maximum(self.best, best)

    @property
    def passes(self) -> NDArray[np.bool_]:
        return _passes(self.best, self.next)


def _compared(
    likeness: NDArray[np.float32], begin: int, back: _Nearest
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the nearest of each row and whether it passes; give `back` those of each column, rows from `begin` on."""
    rows, columns = np.arange(likeness.shape[0]), np.arange(likeness.shape[1])
    forth, from_there = np.argmax(likeness, axis=1), np.argmax(likeness, axis=0)
    best, best_there = likeness[rows, forth], likeness[from_there, columns]
    likeness[rows, forth] = -1
    second = likeness.max(axis=1)
    likeness[rows, forth] = best
    likeness[from_there, columns] = -1
    back.add(from_there + begin, best_there, likeness.max(axis=0))
    return forth, _passes(best, second)


def _passes(best: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Tell which pass COLMAP's tests of angle and ratio."""
    angle, next_angle = (np.arccos(np.clip(likeness, -1, 1)) for likeness in (best, second))
    return np.asarray((angle <= _MAX_ANGLE) & (angle < _MAX_RATIO * next_angle))


def verified(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    first_size: tuple[int, int],
    second_size: tuple[int, int],
    *,
    max_error_px: float = 4.0,
) -> NDArray[np.intp]:
    """Return the indices, (n,), of matched points that lie on the geometry most of them share; none if fewer than 15.

    first, second: (N, 2) float64, x and y in pixels of images of these sizes (width, height). COLMAP's verification
    with its defaults, for cameras of unknown focal length. The same points give the same answer. Raises
    ValueError for other shapes.
    """
    if len(first) != len(second) or first.shape[1:] != (2,) or second.shape[1:] != (2,):
        raise ValueError(f"{first.shape=} {second.shape=}, expected (N, 2) each")
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = 0
    options.ransac.max_error = max_error_px
    if len(first) < options.min_num_inliers:
        return np.zeros(0, np.intp)
    cameras = [
        pycolmap.Camera.create_from_model_name(number, "SIMPLE_PINHOLE", 1.2 * max(size), *size)
        for number, size in ((1, first_size), (2, second_size))
    ]
    both = np.repeat(np.arange(len(first), dtype=np.uint32)[:, None], 2, axis=1)
    geometry = pycolmap.estimate_two_view_geometry(cameras[0], first, cameras[1], second, both, options)
    return np.asarray(geometry.inlier_matches, np.intp).reshape(-1, 2)[:, 0]
