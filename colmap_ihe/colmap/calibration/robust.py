"""Weigh observations so that wrong ones count little: Huber's cost (1964, "Robust estimation of a location parameter").

It is convex, so that two adjustments compare: with Cauchy's, points of few observations end in one of several minima.
"""

from __future__ import annotations

import numpy as np

from colmap_ihe.colmap.calibration.block import Float64

HUBER = 1.5
"""Standard deviations up to which an observation counts in full."""


def weights_of(residuals: Float64, sigma: float) -> Float64:
    """Return (M,), Huber's weight of each observation; 0 where it has no projection."""
    away = np.hypot(residuals[:, 0], residuals[:, 1]) / sigma
    return np.nan_to_num(np.minimum(1, HUBER / np.maximum(away, 1e-9)), nan=0.0)


def robust_cost(residuals: Float64, sigma: float) -> Float64:
    """Return (M,), Huber's cost of each observation in units of `sigma` squared; that of a hundred of them where it
    has no projection."""
    away = np.nan_to_num(np.hypot(residuals[:, 0], residuals[:, 1]) / sigma, nan=100.0)
    return np.where(away < HUBER, away**2, HUBER * (2 * away - HUBER))


def deviation_of(residuals: Float64, freedom: float) -> float:
    """Return the standard deviation of an observation's coordinate, in pixels, from the median of |residuals|;
    `freedom`: the share of the observations that parameters have not used up."""
    finite = np.abs(residuals[np.isfinite(residuals)])
    spread = 1.4826 * float(np.median(finite)) if len(finite) else 1.0
    return float(max(spread, 1e-3) / np.sqrt(max(freedom, 0.05)))
