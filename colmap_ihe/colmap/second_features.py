"""Add the features of the second grey, where the first loses detail, to those in the database."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.array_features import F32, U8, extract_arrays
from colmap_ihe.colmap.database import writing
from colmap_ihe.colmap.extraction import extraction_options
from colmap_ihe.colmap.lower_thresholds import lower, lowers_thresholds
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.executor import in_order, threads_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import FeaturesOptions

_LEAST = 0.5  # of the share of the second grey, where its features count
_MARGIN = 32  # pixels around such a place that are looked at too
_SMALLEST = 1024  # pixels of a place: on a smaller one there are no features worth a window
_TOGETHER = 16  # photographs

Pictures = Callable[[str], tuple[U8, F32]]
"""Of an image by name: its grey with what the second adds, (H, W) uint8, and the share of the second in each pixel,
(H, W) float32 from 0 to 1, 0 where it is masked."""


@dataclass(frozen=True)
class _Window:
    """Hold a part of a picture, at the size at which features are sought. `place` tells where features count; (`left`,
    `top`) is its corner, `scale` the size of a pixel of the photograph there, along x and y."""

    grey: U8
    place: NDArray[np.bool_]
    left: int
    top: int
    scale: tuple[float, float]


def add_second_features(
    database: Path,
    names: Sequence[str],
    pictures: Pictures,
    options: FeaturesOptions,
    executor: Executor,
    progress: Progress,
) -> dict[str, int]:
    """Add them to those of each named image, all or none, and return how many by name; images that have them already
    are left as they are. The features of the first stay first, as they were. Raises `NativeError`, `DiskFullError`,
    `Cancelled`."""
    most = extraction_options(options).eff_max_image_size()
    with pycolmap.Database.open(database) as opened:
        ids = {str(i.name): i.image_id for i in opened.read_all_images()}
    counts: dict[str, int] = {}
    progress.start(len(names), "images, second grey")
    with threads_of(executor) as pool:
        present = [name for name in names if name in ids]
        for begin in range(0, len(present), _TOGETHER):
            some = present[begin : begin + _TOGETHER]
            windows = list(
                in_order(pool, lambda n: list(_windows(*pictures(n), most)), some, progress=progress)
            )
            for name, (points, descriptors) in zip(some, _extracted(windows, options), strict=True):
                if len(points):
                    _append(database, ids[name], points, descriptors)
                    counts[name] = len(points)
                progress.advance()
    return counts


def _windows(picture: U8, shares: F32, most: int) -> Iterator[_Window]:
    """Yield a window around each place where the second grey counts."""
    place = shares >= _LEAST
    if not place.any():
        return
    height, width = picture.shape
    scale = min(1.0, most / max(height, width))
    if scale < 1:  # as COLMAP does
        size = (int(width * scale), int(height * scale))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        place = cv2.resize(place.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    pixel = (width / picture.shape[1], height / picture.shape[0])
    around = cv2.dilate(place.astype(np.uint8), np.ones((2 * _MARGIN + 1,) * 2, np.uint8))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(around, connectivity=8)
    for number, (left, top, across, down, _) in enumerate(boxes[1:].tolist(), 1):
        box = (slice(top, top + down), slice(left, left + across))
        own = place[box] & (labels[box] == number)
        if np.count_nonzero(own) >= _SMALLEST:
            yield _Window(np.ascontiguousarray(picture[box]), own, left, top, pixel)


def _extracted(photographs: Sequence[Sequence[_Window]], options: FeaturesOptions) -> list[tuple[F32, U8]]:
    """Return keypoints as COLMAP has them, and descriptors, of each photograph."""
    windows = [window for some in photographs for window in some]
    extraction = extraction_options(options)
    extraction.max_image_size = max((max(window.grey.shape) for window in windows), default=1)
    if lowers_thresholds(options):
        lower(extraction)  # here features have run out
    greys = [window.grey for window in windows]
    found = iter(extract_arrays(greys, extraction, "features of the second grey", octaves=options.octaves))
    return [_joined([_of_place(window, *next(found)) for window in some]) for some in photographs]


def _of_place(window: _Window, points: F32, descriptors: U8) -> tuple[F32, U8]:
    """Return the features that lie where the second grey counts, at their places in the photograph."""
    columns, rows = (np.clip(points[:, k].astype(int), 0, window.place.shape[1 - k] - 1) for k in (0, 1))
    kept = window.place[rows, columns] if len(points) else np.zeros(0, bool)
    points = points[kept]
    points[:, :2] += (window.left, window.top)
    across, down = window.scale
    # x, y, then the affine shape a11 a12 a21 a22, or a scale and an angle
    factors = (
        (across, down, across, across, down, down) if points.shape[1] == 6 else (across, down, across, 1)
    )
    return points * np.array(factors, np.float32), descriptors[kept]


def _joined(parts: Sequence[tuple[F32, U8]]) -> tuple[F32, U8]:
    if not parts:
        return np.empty((0, 6), np.float32), np.empty((0, 128), np.uint8)
    return np.concatenate([p for p, _ in parts]), np.concatenate([d for _, d in parts])


def _append(database: Path, image_id: int, points: F32, descriptors: U8) -> None:
    """Append features to those of an image, in one step, unless they are its last ones."""
    rows: Mapping[str, bytes] = {"keypoints": points.tobytes(), "descriptors": descriptors.tobytes()}
    with writing(database) as opened:
        for table, added in rows.items():
            (data,) = opened.execute(f"SELECT data FROM {table} WHERE image_id = ?", (image_id,)).fetchone()
            if (data or b"").endswith(added):
                return
            opened.execute(
                f"UPDATE {table} SET rows = rows + ?, data = ? WHERE image_id = ?",
                (len(points), (data or b"") + added, image_id),
            )
