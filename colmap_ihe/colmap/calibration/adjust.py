"""Adjust cameras, poses and points together, with each parameter of the cameras free, tied or held on its own.

COLMAP frees the focal length, the principal point and the distortion of a camera all or none. This is the same least
squares over what a basis spans, with priors, robust weights (robust.py) and the points eliminated (equations.py), by
Levenberg and Marquardt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from colmap_ihe.colmap.calibration.block import Block, Float64, Ints
from colmap_ihe.colmap.calibration.equations import Prior, moved, solve, sums, system_of, weighted
from colmap_ihe.colmap.calibration.lens import FreeCamera, Terms, derivatives
from colmap_ihe.colmap.calibration.robust import deviation_of, robust_cost
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import SILENT, Progress

MOST_STEPS = 15
"""Of an adjustment, which takes four or five where the model is nearly right."""
_WRONG = 4.0  # standard deviations from which on an observation is taken for a wrong one
_CLOSE = 1.0  # of the cost, to its minimum, in units of sigma squared
_OTHER = 0.03  # change of sigma from which on the cost is another


@dataclass(frozen=True)
class Adjusted:
    """Hold an adjusted block, the free parameters' `values` (K,), `sigma`, the standard deviation of an observation's
    coordinate in pixels, and the `residuals` (M, 2)."""

    block: Block
    values: Float64
    sigma: float
    residuals: Float64
    prior_cost: float

    def cost(self, sigma: float) -> float:
        """Return the robust cost in units of `sigma` squared, that of the priors with it."""
        return float(robust_cost(self.residuals, sigma).sum()) + self.prior_cost


def adjust(
    block: Block,
    cameras: Sequence[FreeCamera],
    values: Float64,
    prior: Prior,
    *,
    most: int = MOST_STEPS,
    sigma: float | None = None,
    progress: Progress = SILENT,
) -> Adjusted:
    """Return the block and the free parameters where the robust cost is least, from `values` (K,) and the block's poses
    and points on, after `most` iterations at the latest. `sigma`: in pixels, measured if None. Raises `Cancelled`."""
    freedom = 1 - (3 * len(block.points) + 6 * len(block.rotations)) / max(1, 2 * len(block.pixels))
    terms = derivatives(block, cameras, values)
    scale = sigma or deviation_of(terms.residuals, freedom)
    cost = _cost(terms, scale, prior, values)
    damping, gained = 1e-6, 0.0
    for _ in range(most):
        progress.check()
        ahead, there, gain = _step(block, terms, scale, prior, values, damping)
        if gain < _CLOSE and damping < 1e-3:
            break
        ahead_terms = derivatives(ahead, cameras, there)
        ahead_cost = _cost(ahead_terms, scale, prior, there)
        if ahead_cost > cost:
            damping = max(1e-4, 10 * damping)
            continue
        block, values, terms, cost, damping = ahead, there, ahead_terms, ahead_cost, damping / 10
        now = deviation_of(terms.residuals, freedom)
        if sigma is None and abs(now / scale - 1) > _OTHER:
            scale = now
            cost = _cost(terms, scale, prior, values)
        if gain < min(2 * _CLOSE, gained / 2) and damping < 1e-3:
            break  # a step gains a part of what the last one did, which is less than `_CLOSE` now
        gained = gain
    return Adjusted(block, values, scale, terms.residuals, prior.cost(values))


def _step(
    block: Block, terms: Terms, sigma: float, prior: Prior, values: Float64, damping: float
) -> tuple[Block, Float64, float]:
    """Return the block and the free parameters (K,) a step further, and what the cost should gain by it. The equations
    are left here: they are the largest arrays."""
    system = system_of(block, terms, sigma, prior, values, damping)
    move, gain = solve(system, damping)
    ahead, there = moved(block, values, system, move)
    return ahead, there, gain


def place(block: Block, cameras: Sequence[pycolmap.Camera], sigma: float, *, rounds: int = 3) -> Block:
    """Return the block with its points where these cameras see them best, the poses held."""
    free = [FreeCamera(camera, np.zeros((len(camera.params), 0))) for camera in cameras]
    for _ in range(rounds):
        terms = derivatives(block, free, np.zeros(0))
        by_world, *_, residuals = weighted(block, terms, sigma)
        squares = sums(block, by_world.transpose(0, 2, 1) @ by_world)
        right = sums(block, np.einsum("mki,mk->mi", by_world, residuals))
        squares[:, range(3), range(3)] += 1e-6 * np.trace(squares, axis1=1, axis2=2)[:, None] + 1e-12
        block = replace(block, points=block.points - np.linalg.solve(squares, right[..., None])[..., 0])
    return block


def cleaned(block: Block, cameras: Sequence[pycolmap.Camera], sigma: float) -> tuple[Block, Ints]:
    """Return the block with its points placed, and without observations that are wrong by these cameras and poses; and
    the numbers of the points that are left."""
    block = place(block, cameras, sigma)
    residuals = residuals_of(block, cameras)
    freedom = 1 - 3 * len(block.points) / max(1, 2 * len(block.pixels))
    most = _WRONG * deviation_of(residuals, freedom)
    kept, points = block.of_observations(np.hypot(residuals[:, 0], residuals[:, 1]) < most)
    return place(kept, cameras, sigma, rounds=2), points  # no longer held off by wrong observations


def residuals_of(block: Block, cameras: Sequence[pycolmap.Camera]) -> Float64:
    """Return (M, 2), in pixels; nan where an observation has no projection."""
    held = [FreeCamera(camera, np.zeros((len(camera.params), 0))) for camera in cameras]
    return derivatives(block, held, np.zeros(0)).residuals


def _cost(terms: Terms, sigma: float, prior: Prior, values: Float64) -> float:
    return float(robust_cost(terms.residuals, sigma).sum()) + prior.cost(values)
