"""Compare estimated depth maps with true ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.evaluation.truth import F32, F64, TrueImage

_EDGE = 0.02  # relative step of true depth within 3 x 3 pixels that counts as an edge
TOLERANCE = 0.02
"""Relative error up to which a depth is right."""
_NEAR = 4  # pixels from an edge
_AROUND = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class Judged:
    """Count pixels: `seeing` the scene, with a `right` depth, and with a `wrong` one. A depth where there is nothing is
    wrong; beside an edge either side's depth is right."""

    seeing: int = 0
    right: int = 0
    wrong: int = 0

    @property
    def right_percent(self) -> float:
        """Return the share of the pixels that see the scene which have a right depth."""
        return 100 * self.right / self.seeing if self.seeing else float("nan")

    @property
    def wrong_percent(self) -> float:
        """Return the share of the depths that are wrong."""
        depths = self.right + self.wrong
        return 100 * self.wrong / depths if depths else float("nan")

    def __add__(self, other: Judged) -> Judged:
        """Return the counts of both together."""
        return Judged(self.seeing + other.seeing, self.right + other.right, self.wrong + other.wrong)


@dataclass(frozen=True)
class DepthErrors:
    """Hold the errors of one image or several.

    `relative_percent` (N,) float32 is |estimated / true - 1| in percent where both are known, away from edges. `all`
    judges every pixel, `near_edges` those within 4 pixels of an edge of true depth.
    """

    relative_percent: F32
    all: Judged
    near_edges: Judged

    @property
    def median_percent(self) -> float:
        """Return the median error, nan where nothing could be compared."""
        return float(np.median(self.relative_percent)) if self.relative_percent.size else float("nan")


def depth_errors(estimated: F32, calibration: F64, truth: TrueImage, metres_per_unit: float) -> DepthErrors:
    """Compare one depth map with the truth. Raises ValueError for one that is not (H, W).

    `estimated` is (H, W) float32 along the optical axis in the model's unit, not positive or nan
    where unknown; `calibration` its K (3, 3), of an undistorted camera at the place of the true
    one, perhaps of another size. `metres_per_unit` is the scale of `PoseErrors.world_from_model`.
    Each estimated pixel is compared with the true pixel nearest to its ray, and next to an edge with those around it.
    """
    rows, columns, inside = true_pixels(estimated.shape, calibration, truth)
    rays, true = (rows, columns), truth.depth_m()
    nearest, farthest = (np.asarray(f(true, _AROUND), np.float32) for f in (cv2.erode, cv2.dilate))
    edge = np.asarray(farthest > (1 + _EDGE) * nearest)
    near = np.asarray(cv2.dilate(edge.astype(np.uint8), np.ones((2 * _NEAR + 1,) * 2, np.uint8)), bool)[rays]
    depth, with_depth = estimated * np.float32(metres_per_unit), inside & (estimated > 0)
    error = _relative(depth, true[rays])
    beside = np.minimum(_relative(depth, nearest[rays]), _relative(depth, farthest[rays]))
    fits = np.minimum(error, np.where(edge[rays], beside, np.inf)) <= TOLERANCE
    seeing, wrong = inside & (true[rays] > 0), with_depth & ~fits
    right = seeing & with_depth & fits
    compared = 100 * error[with_depth & seeing & ~edge[rays]]
    judged, near_edges = (
        Judged(int((seeing & part).sum()), int((right & part).sum()), int((wrong & part).sum()))
        for part in (inside, near)
    )
    return DepthErrors(compared.astype(np.float32), judged, near_edges)


def true_pixels(
    shape: tuple[int, ...], calibration: F64, truth: TrueImage
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Return row (H, 1) and column (1, W) of the true pixel nearest to the ray of each pixel of a map (H, W), and
    whether it is in the true image, (H, W). Raises as `depth_errors`."""
    if len(shape) != 2:
        raise ValueError(f"{shape=}, expected (H, W)")
    # Pinhole to pinhole at one place and attitude: each axis is a shift and a scale.
    to_true = truth.calibration @ np.linalg.inv(calibration)
    row = (to_true[1, 1] * (np.arange(shape[0]) + 0.5) + to_true[1, 2])[:, None]
    column = (to_true[0, 0] * (np.arange(shape[1]) + 0.5) + to_true[0, 2])[None, :]
    inside = (row >= 0) & (row < truth.height) & (column >= 0) & (column < truth.width)
    rows = np.clip(np.floor(row), 0, truth.height - 1).astype(np.intp)
    columns = np.clip(np.floor(column), 0, truth.width - 1).astype(np.intp)
    return rows, columns, inside


def pooled(errors: Iterable[DepthErrors]) -> DepthErrors:
    """Return the errors of several images as if they were one."""
    parts = list(errors)
    relative = np.concatenate([np.empty(0, np.float32), *(part.relative_percent for part in parts)])
    return DepthErrors(
        relative, sum((p.all for p in parts), Judged()), sum((p.near_edges for p in parts), Judged())
    )


def _relative(depth: F32, true: F32) -> F32:
    """Return |depth / true - 1|, infinite where there is nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(true > 0, np.abs(depth / true - 1), np.inf), np.float32)
