"""Judge depth on the far side of depth edges, and normals near edges and away from them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.dense.stereo.normals import best_slopes, normals_from_slopes
from colmap_ihe.evaluation.depth_errors import TOLERANCE, true_pixels
from colmap_ihe.evaluation.truth import F32, F64, TrueImage

FAR_SIDE_PX = 4
NORMALS_PX = (2, 6)
"""Pixels from an edge between which normals are judged as near it; those farther away are judged as elsewhere."""
NORMAL_WRONG_DEG = 10.0
_TRUE_NORMAL_PX = 2  # half of the window of true normals, which reaches across no edge at NORMALS_PX
_AROUND = np.ones((3, 3), np.uint8)
_Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class EdgeErrors:
    """Hold the errors of one image or several at edges.

    `far_side_pixels` see the far side of an edge of true depth within `FAR_SIDE_PX`; `far_side_percent` (N,) float32
    is estimated / true - 1 in percent of those that have a depth. `normals_near_deg` and `normals_elsewhere_deg` (N,)
    float32 are angles to the true normals.
    """

    far_side_pixels: int
    far_side_percent: F32
    normals_near_deg: F32
    normals_elsewhere_deg: F32

    @property
    def far_side_covered_percent(self) -> float:
        """Return the share of the far side's pixels that have a depth, nan without any."""
        return (
            100 * self.far_side_percent.size / self.far_side_pixels if self.far_side_pixels else float("nan")
        )

    @property
    def far_side_wrong_percent(self) -> float:
        """Return the share of the far side's depths that are wrong by more than `TOLERANCE`, nan without any."""
        return _share_percent(np.abs(self.far_side_percent) > 100 * TOLERANCE)

    @property
    def far_side_median_percent(self) -> float:
        """Return the median signed error of the far side's depths, nan without any; fattened foreground is negative."""
        return _median(self.far_side_percent)

    @property
    def normals_near_wrong_percent(self) -> float:
        """Return the share of the normals near edges that are off by more than `NORMAL_WRONG_DEG`, nan without any."""
        return _share_percent(self.normals_near_deg > NORMAL_WRONG_DEG)

    @property
    def normals_elsewhere_median_deg(self) -> float:
        """Return the median angle elsewhere, nan without any."""
        return _median(self.normals_elsewhere_deg)


def edge_errors(
    depth: F32, normals: F32, calibration: F64, truth: TrueImage, metres_per_unit: float
) -> EdgeErrors:
    """Compare a depth map (H, W) and its normals (H, W, 3) with the truth at edges. Arguments and errors as of
    `depth_errors`.

    An edge is where true depth steps by more than `TOLERANCE` between neighbours. On the far side are those pixels
    whose true depth is larger by as much than that of a pixel within `FAR_SIDE_PX`; the error of those that touch the
    edge is that to the nearer side where it is smaller, since half a pixel decides there which side they see.
    """
    rows, columns, inside = true_pixels(depth.shape, calibration, truth)
    true = truth.depth_m()
    edge = _edges(true)
    behind = true > (1 + TOLERANCE) * cv2.erode(true, np.ones((2 * FAR_SIDE_PX + 1,) * 2, np.uint8))
    far_side = inside & (behind & _within(edge, FAR_SIDE_PX))[rows, columns]
    beside = np.where(edge, cv2.erode(true, _AROUND), true)
    to_own, to_nearer = (_relative_percent(depth * metres_per_unit, t[rows, columns]) for t in (true, beside))
    relative = np.where(np.abs(to_nearer) < np.abs(to_own), to_nearer, to_own)
    angles, known = _angles(normals, true, truth.calibration, rows, columns)
    judged = known & inside & (depth > 0)
    outside, farther = (~_within(edge, px)[rows, columns] for px in (NORMALS_PX[0] - 1, NORMALS_PX[1]))
    return EdgeErrors(
        int(far_side.sum()),
        np.asarray(relative[far_side & (depth > 0)], np.float32),
        angles[judged & outside & ~farther],
        angles[judged & farther],
    )


def pooled_edges(errors: Iterable[EdgeErrors]) -> EdgeErrors:
    """Return the errors of several images as if they were one."""
    parts = list(errors)
    nothing = np.empty(0, np.float32)
    return EdgeErrors(
        sum(part.far_side_pixels for part in parts),
        np.concatenate([nothing, *(part.far_side_percent for part in parts)]),
        np.concatenate([nothing, *(part.normals_near_deg for part in parts)]),
        np.concatenate([nothing, *(part.normals_elsewhere_deg for part in parts)]),
    )


def _edges(true: F32) -> _Bool:
    """Return where true depth steps within 3 x 3 pixels, or ends."""
    return np.asarray(cv2.dilate(true, _AROUND) > (1 + TOLERANCE) * cv2.erode(true, _AROUND))


def _within(edge: _Bool, pixels: int) -> _Bool:
    around = np.ones((2 * pixels + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(edge.astype(np.uint8), around), bool)


def _relative_percent(depth: F32, true: F32) -> F32:
    """Return the signed error of `depth` in percent, infinite where there is nothing."""
    relative = np.divide(depth, true, out=np.full_like(depth, np.inf), where=true > 0)
    return np.asarray(100 * (relative - 1), np.float32)


def _angles(
    normals: F32, true: F32, calibration: F64, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[F32, _Bool]:
    """Return the angles in degrees between normals (H, W, 3) and the true ones, and where both are known."""
    inverse = np.divide(1, true, out=np.zeros_like(true), where=true > 0)
    slope_x, slope_y, _ = best_slopes(inverse, _TRUE_NORMAL_PX, _TRUE_NORMAL_PX)
    expected = normals_from_slopes(inverse, slope_x, slope_y, calibration)[rows, columns]
    cosines = np.clip((normals * expected).sum(axis=-1), -1, 1)
    known = (normals != 0).any(axis=-1) & (expected != 0).any(axis=-1)
    return np.degrees(np.arccos(cosines)).astype(np.float32), known


def _share_percent(values: _Bool) -> float:
    return 100 * float(np.mean(values)) if values.size else float("nan")


def _median(values: F32) -> float:
    return float(np.median(values)) if values.size else float("nan")
