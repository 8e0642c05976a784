"""Compare estimated depth maps with true ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.evaluation.truth import F32, F64, TrueImage

_EDGE = 0.02  # relative step of true depth within 3 x 3 pixels that counts as an edge


@dataclass(frozen=True)
class DepthErrors:
    """Hold the errors of one image or several.

    `relative_percent` (N,) float32 is |estimated / true - 1| in percent where both are known, away
    from edges; `seeing` pixels see the scene, `estimated` of them have a depth.
    """

    relative_percent: F32
    seeing: int
    estimated: int

    @property
    def median_percent(self) -> float:
        """Return the median error, nan where nothing could be compared."""
        return float(np.median(self.relative_percent)) if self.relative_percent.size else float("nan")

    @property
    def coverage_percent(self) -> float:
        """Return the share of the pixels that see the scene which have an estimated depth."""
        return 100 * self.estimated / self.seeing if self.seeing else float("nan")


def depth_errors(estimated: F32, calibration: F64, truth: TrueImage, metres_per_unit: float) -> DepthErrors:
    """Compare one depth map with the truth. Raises ValueError for one that is not (H, W).

    `estimated` is (H, W) float32 along the optical axis in the model's unit, not positive or nan
    where unknown; `calibration` its K (3, 3), of an undistorted camera at the place of the true
    one, perhaps of another size. `metres_per_unit` is the scale of `PoseErrors.world_from_model`.
    Each estimated pixel is compared with the true pixel nearest to its ray, skipping edges of depth.
    """
    if estimated.ndim != 2:
        raise ValueError(f"{estimated.shape=}, expected (H, W)")
    true = truth.depth_m()
    # Pinhole to pinhole at one place and attitude: each axis is a shift and a scale.
    to_true = truth.calibration @ np.linalg.inv(calibration)
    column = to_true[0, 0] * (np.arange(estimated.shape[1]) + 0.5) + to_true[0, 2]
    row = to_true[1, 1] * (np.arange(estimated.shape[0]) + 0.5) + to_true[1, 2]
    inside = ((row >= 0) & (row < true.shape[0]))[:, None] & (column >= 0) & (column < true.shape[1])
    rows = np.clip(np.floor(row), 0, true.shape[0] - 1).astype(np.intp)
    columns = np.clip(np.floor(column), 0, true.shape[1] - 1).astype(np.intp)
    expected = true[np.ix_(rows, columns)]
    seeing = inside & (expected > 0)
    both = seeing & (estimated > 0)
    compared = both & ~_at_edge(true)[np.ix_(rows, columns)]
    error = 100 * np.abs(estimated[compared] * np.float32(metres_per_unit) / expected[compared] - 1)
    return DepthErrors(error.astype(np.float32), int(seeing.sum()), int(both.sum()))


def pooled(errors: Iterable[DepthErrors]) -> DepthErrors:
    """Return the errors of several images as if they were one."""
    parts = list(errors)
    relative = np.concatenate([np.empty(0, np.float32), *(part.relative_percent for part in parts)])
    return DepthErrors(relative, sum(part.seeing for part in parts), sum(part.estimated for part in parts))


def _at_edge(depth: F32) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return where depth within 3 x 3 pixels differs by more than `_EDGE`; nothing (0) beside something does too."""
    kernel = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(depth, kernel) > (1 + _EDGE) * cv2.erode(depth, kernel))
