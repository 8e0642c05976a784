"""Adjust a model together with its control: poses, cameras and points, so that tie points, surveyed points, scale bars
and camera positions fit as well as their accuracies say.

The tie points' part is that of self-calibration (colmap/calibration); this adds the control, by Levenberg and
Marquardt. Triggs et al. 2000, "Bundle adjustment: a modern synthesis".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.colmap.calibration.block import Block, block_of, thinned
from colmap_ihe.colmap.calibration.equations import Prior, System, moved, solved, system_of
from colmap_ihe.colmap.calibration.lens import FreeCamera, Terms, derivatives
from colmap_ihe.colmap.calibration.rebuild import give
from colmap_ihe.colmap.calibration.robust import deviation_of, robust_cost
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine import threads
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.survey.control_equations import ControlTerms, Rows, rows_of
from colmap_ihe.survey.observations import F64

MOST_IMAGES = 600
"""Images of a model from which on it is only moved as a whole: the equations would take gigabytes."""
_POINTS_AN_IMAGE = 600
_MOST_STEPS = 25
_CLOSE = 0.01  # of the cost, in units of variances, to its minimum
_GAUGE = 1e-9  # of the scaled equations, in directions that nothing determines


@dataclass(frozen=True)
class Controlled:
    """Hold what came of an adjustment: `points` (T, 3) and their `covariances` (T, 3, 3), of cameras and sights
    together, and `sigma_px`, the standard deviation of a tie point's coordinate."""

    points: F64
    covariances: F64
    sigma_px: float


@dataclass(frozen=True)
class _State:
    """Hold poses and tie points, the free parameters (K,) and the named points (T, 3)."""

    block: Block
    values: F64
    points: F64


def adjust_with_control(
    model: pycolmap.Reconstruction,
    terms: ControlTerms,
    points: F64,
    free_params: Mapping[int, Sequence[int]],
    progress: Progress = SILENT,
) -> Controlled:
    """Adjust a model, which is in metres already, with control; `points` (T, 3) are where the named points lie in it,
    images are told by their place among `reg_image_ids` in order. `free_params`: by camera id the parameters that are
    free, by their places. Raises `Cancelled`."""
    image_ids = sorted(model.reg_image_ids())
    camera_ids = sorted({model.images[i].camera_id for i in image_ids})
    whole, _ = block_of(model, image_ids, camera_ids)
    block = whole.of_points(thinned(whole, _POINTS_AN_IMAGE * len(image_ids)))
    free = free_cameras([model.cameras[i] for i in camera_ids], [free_params.get(i, ()) for i in camera_ids])
    count = free[0].basis.shape[1]
    prior = Prior(np.zeros(count), np.full(count, np.inf))
    with threads.limited(1):  # one thread gives the same to the bit
        state, sigma = _adjusted(_State(block, np.zeros(count), points), terms, free, prior, progress)
        covariances = _covariances(state, terms, free, prior, sigma)
    cameras = [one.at(state.values) for one in free]
    give(model, image_ids, camera_ids, cameras, state.block, sigma)
    model.update_point_3d_errors()
    return Controlled(state.points, covariances, sigma)


def free_cameras(
    cameras: Sequence[pycolmap.Camera], free_params: Sequence[Sequence[int]]
) -> list[FreeCamera]:
    """Return the cameras with these parameters free; focal lengths that are equal move alike."""
    columns: list[list[F64]] = []
    for camera, free in zip(cameras, free_params, strict=True):
        params, focal = np.asarray(camera.params), list(camera.focal_length_idxs())
        together = len(focal) == 2 and params[focal[0]] == params[focal[1]] and set(focal) <= set(free)
        groups = [focal] if together else []
        groups += [[index] for index in free if not (together and index in focal)]
        columns.append([np.isin(np.arange(len(params)), group).astype(np.float64) for group in groups])
    total, offset, result = sum(map(len, columns)), 0, []
    for camera, mine in zip(cameras, columns, strict=True):
        basis = np.zeros((len(camera.params), total))
        for number, column in enumerate(mine):
            basis[:, offset + number] = column
        offset += len(mine)
        result.append(FreeCamera(camera, basis))
    return result


def _adjusted(
    state: _State, terms: ControlTerms, free: Sequence[FreeCamera], prior: Prior, progress: Progress
) -> tuple[_State, float]:
    block = state.block
    freedom = 1 - (3 * len(block.points) + 6 * len(block.rotations)) / max(1, 2 * len(block.pixels))
    ties = derivatives(block, free, state.values)
    sigma = deviation_of(ties.residuals, freedom)
    rows = rows_of(terms, block, free, state.values, state.points)
    cost, damping = _cost(ties, sigma, rows), 1e-6
    for _ in range(_MOST_STEPS):
        progress.check()
        ahead, gain = _step(state, ties, rows, sigma, prior, damping)
        if gain < _CLOSE and damping < 1e-3:
            break
        ahead_ties = derivatives(ahead.block, free, ahead.values)
        ahead_rows = rows_of(terms, ahead.block, free, ahead.values, ahead.points)
        ahead_cost = _cost(ahead_ties, sigma, ahead_rows)
        if ahead_cost > cost:
            damping = max(1e-4, 10 * damping)
            continue
        state, ties, rows, cost, damping = ahead, ahead_ties, ahead_rows, ahead_cost, damping / 10
    return state, sigma


def _cost(ties: Terms, sigma: float, rows: Rows) -> float:
    return float(robust_cost(ties.residuals, sigma).sum()) + rows.cost


def _step(
    state: _State, ties: Terms, rows: Rows, sigma: float, prior: Prior, damping: float
) -> tuple[_State, float]:
    """Return the state a step further, and what the cost should gain by it."""
    system = system_of(state.block, ties, sigma, prior, state.values, damping)
    matrix, gradient = _together(system, rows)
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    scaled = matrix * scale[:, None] * scale
    scaled[np.diag_indices(len(scaled))] += max(damping, _GAUGE)
    move = -solved(scaled, gradient * scale) * scale
    own = np.einsum("pij,pj->pi", system.factors, system.right)
    count = len(system.gradient)
    block, values = moved(state.block, state.values, system, move[:count])
    return (
        _State(block, values, state.points + move[count:].reshape(-1, 3)),
        float(-gradient @ move + (own**2).sum()),
    )


def _together(system: System, rows: Rows) -> tuple[F64, F64]:
    """Return the normal equations of all unknowns, (C, C) and (C,), tie points eliminated."""
    matrix = rows.jacobian.T @ rows.jacobian
    gradient = rows.jacobian.T @ rows.residuals
    count = len(system.gradient)
    matrix[:count, :count] += system.matrix
    gradient[:count] += system.gradient
    return matrix, gradient


def _covariances(
    state: _State, terms: ControlTerms, free: Sequence[FreeCamera], prior: Prior, sigma: float
) -> F64:
    """Return (T, 3, 3), of the named points, with what cameras and poses leave open."""
    ties = derivatives(state.block, free, state.values)
    system = system_of(state.block, ties, sigma, prior, state.values, 0.0)
    rows = rows_of(terms, state.block, free, state.values, state.points)
    matrix, _ = _together(system, rows)
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    scaled = matrix * scale[:, None] * scale
    scaled[np.diag_indices(len(scaled))] += _GAUGE
    first = len(system.gradient)
    columns = solved(scaled, np.eye(len(scaled))[:, first:])[first:] * scale[first:, None] * scale[first:]
    each = 3 * np.arange(len(state.points))[:, None] + np.arange(3)
    return np.asarray(columns[each[:, :, None], each[:, None, :]])
