"""Measure pairs of photographs: how well they match, how the camera moved, and how true its movement is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import cv2
import numpy as np

from colmap_ihe.evaluation.truth import F64

Movement = Literal["parallel", "rotated", "tilted"]
MOVEMENTS: tuple[Movement, ...] = ("parallel", "rotated", "tilted")
_PARALLEL_DEG = 8.0  # turned by less, a camera counts as moved sideways only


@dataclass(frozen=True)
class PairMatches:
    """Count the putative matches of a pair, and those that its geometry verifies."""

    putative: int
    inliers: int


def efficiency_percent(pairs: Sequence[PairMatches]) -> float | None:
    """Return the share of inliers in the putative matches of all pairs (the paper's Table 1); None without any."""
    putative = sum(pair.putative for pair in pairs)
    return 100 * sum(pair.inliers for pair in pairs) / putative if putative else None


def movement(first: F64, second: F64) -> Movement:
    """Tell how the camera moved between two poses, (3, 4) `cam_from_world`: parallel to itself, turned to the side or
    about its axis, or tilted up or down."""
    turn, _ = cv2.Rodrigues(second[:, :3] @ first[:, :3].T)
    across, down, along = np.abs(np.degrees(turn.ravel()))
    if np.hypot(np.hypot(across, down), along) < _PARALLEL_DEG:
        return "parallel"
    return "tilted" if across > max(down, along) else "rotated"


def relative_errors_deg(poses: Mapping[str, F64], true: Mapping[str, F64]) -> F64:
    """Return (n,) float64, in degrees: the larger error of relative rotation and direction of translation of each pair,
    180 where one of the two has no pose. Keys as in `true`."""
    errors = []
    for first, second in combinations(sorted(true), 2):
        if first not in poses or second not in poses:
            errors.append(180.0)
            continue
        (turned, moved), (true_turned, true_moved) = (_relative(p[first], p[second]) for p in (poses, true))
        rotation, _ = cv2.Rodrigues(turned @ true_turned.T)
        lengths = np.linalg.norm(moved) * np.linalg.norm(true_moved)
        cosine = float(moved @ true_moved) / lengths if lengths else 1.0
        angle = max(float(np.linalg.norm(rotation)), float(np.arccos(np.clip(cosine, -1, 1))))
        errors.append(float(np.degrees(angle)))
    return np.array(errors)


def area_under_curve_percent(errors: F64, most: float) -> float:
    """Return the mean share of `errors` below each threshold up to `most`: 100 where all are 0, nan for none."""
    if not len(errors):
        return float("nan")
    return 100 * float(np.mean(np.maximum(0.0, 1 - errors / most)))


def _relative(first: F64, second: F64) -> tuple[F64, F64]:
    rotation = second[:, :3] @ first[:, :3].T
    return rotation, second[:, 3] - rotation @ first[:, 3]
