"""Judge a calibration by points that it was not computed from: by their error in cameras and poses as they came out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_ihe.colmap.calibration.adjust import place, residuals_of
from colmap_ihe.colmap.calibration.block import Block, Float64
from colmap_ihe.colmap.calibration.choose import Chooser, Fit
from colmap_ihe.colmap.calibration.robust import robust_cost

_EVERY = 4  # of the points one is held out
_CLEARLY = 2.0  # standard errors
_MOST = 10.0  # standard deviations from which on all observations cost the same


@dataclass(frozen=True)
class HeldOut:
    """Hold the median reprojection error of points held out, in pixels, by COLMAP's model and by the one chosen, and by
    how many standard errors the latter is better."""

    colmap_px: float
    chosen_px: float
    standard_errors: float

    @property
    def worse(self) -> bool:
        """Tell whether the choice is clearly worse."""
        return self.standard_errors < -_CLEARLY


def held_out(chooser: Chooser, base: Fit, chosen: Fit) -> HeldOut:
    """Return how two fits compare on every fourth point of the block, each made again without these points."""
    number = np.arange(len(chooser.block.points))
    seen, held = (
        chooser.block.of_points(np.flatnonzero((number % _EVERY == _EVERY - 1) == out))
        for out in (False, True)
    )
    sigma = min(base.adjusted.sigma, chosen.adjusted.sigma)
    if chosen is base:
        median, _ = _judged(replace(chooser, block=seen), held, base, sigma)
        return HeldOut(median, median, 0.0)
    (first, first_cost), (second, second_cost) = (
        _judged(replace(chooser, block=seen), held, fit, sigma) for fit in (base, chosen)
    )
    less = first_cost - second_cost
    spread = float(less.std()) / max(1, len(less)) ** 0.5
    return HeldOut(first, second, float(less.mean()) / spread if spread > 0 else 0.0)


def _judged(chooser: Chooser, held: Block, fit: Fit, sigma: float) -> tuple[float, Float64]:
    """Return the median error of the points held out, in pixels, and the cost of each point (n,): wrong observations,
    which the fits are without, all count the same, or the largest few would outweigh all others."""
    made = chooser.again(fit)
    poses = made.adjusted.block
    there = replace(held, rotations=poses.rotations, translations=poses.translations)
    there = place(there, made.cameras, sigma)
    residuals = residuals_of(there, made.cameras)
    most = robust_cost(np.array([[_MOST * sigma, 0.0]]), sigma)
    costs = np.add.reduceat(np.minimum(robust_cost(residuals, sigma), most), there.starts[:-1])
    errors = np.hypot(residuals[:, 0], residuals[:, 1])
    errors[np.isnan(errors)] = np.inf  # a point that is behind a camera
    return float(np.median(errors)), costs
