"""Adjust a model together with its control: poses, cameras and points, so that tie points, surveyed points, scale bars
and camera positions fit as well as their accuracies say.

The tie points' part is that of self-calibration (colmap/calibration); this adds the control, by Levenberg and
Marquardt. Triggs et al. 2000, "Bundle adjustment: a modern synthesis".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from colmap_ihe.colmap.calibration.block import part_of, thinned
from colmap_ihe.colmap.calibration.equations import Prior, System, moved, system_of
from colmap_ihe.colmap.calibration.lens import FreeCamera, Terms, derivatives
from colmap_ihe.colmap.calibration.rebuild import give
from colmap_ihe.colmap.calibration.robust import deviation_of, robust_cost
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine import threads
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.survey.control_equations import ControlTerms, Rows, rows_of
from colmap_ihe.survey.observations import F64
from colmap_ihe.survey.spread import Spread, State, solution

MOST_IMAGES = 600
"""Images of a model from which on it is only moved as a whole: the equations would take gigabytes."""
_POINTS_AN_IMAGE = 600
_MOST_STEPS = 25
_CLOSE = 0.01  # of the cost, in units of variances, to its minimum


def adjust_with_control(
    model: pycolmap.Reconstruction,
    terms: ControlTerms,
    free_params: Mapping[int, Sequence[int]],
    progress: Progress = SILENT,
) -> Spread:
    """Adjust a model, which is in metres already, with control, and return how well it is known then; images are told
    by their place among `reg_image_ids` in order. `free_params`: by camera id the parameters that are free, by their
    places. Raises `Cancelled`, and `LinAlgError` where there is no solution."""
    image_ids = sorted(model.reg_image_ids())
    camera_ids = sorted({model.images[i].camera_id for i in image_ids})
    part = part_of(model, image_ids, camera_ids)
    block = part.block.of_points(thinned(part.block, _POINTS_AN_IMAGE * len(image_ids)))
    free = free_cameras([model.cameras[i] for i in camera_ids], [free_params.get(i, ()) for i in camera_ids])
    count = free[0].basis.shape[1]
    prior = Prior(np.zeros(count), np.full(count, np.inf))
    with threads.limited(1):  # one thread gives the same to the bit
        state, sigma = _adjusted(State(block, free, np.zeros(count), terms.located), terms, prior, progress)
        matrix = _normal_matrix(state, terms, prior, sigma)
    cameras = [one.at(state.values) for one in free]
    give(model, part, cameras, state.block, sigma)
    model.update_point_3d_errors()
    return Spread(state, matrix)


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


def _adjusted(state: State, terms: ControlTerms, prior: Prior, progress: Progress) -> tuple[State, float]:
    block = state.block
    freedom = 1 - (3 * len(block.points) + 6 * len(block.rotations)) / max(1, 2 * len(block.pixels))
    ties = derivatives(block, state.cameras, state.values)
    sigma = deviation_of(ties.residuals, freedom)
    rows = rows_of(terms, block, state.cameras, state.values, state.points)
    cost, damping = _cost(ties, sigma, rows), 1e-6
    for _ in range(_MOST_STEPS):
        progress.check()
        ahead, gain = _step(state, ties, rows, sigma, prior, damping)
        if gain < _CLOSE and damping < 1e-3:
            break
        ahead_ties = derivatives(ahead.block, ahead.cameras, ahead.values)
        ahead_rows = rows_of(terms, ahead.block, ahead.cameras, ahead.values, ahead.points)
        ahead_cost = _cost(ahead_ties, sigma, ahead_rows)
        if ahead_cost > cost:
            damping = max(1e-4, 10 * damping)
            continue
        state, ties, rows, cost, damping = ahead, ahead_ties, ahead_rows, ahead_cost, damping / 10
    return state, sigma


def _cost(ties: Terms, sigma: float, rows: Rows) -> float:
    return float(robust_cost(ties.residuals, sigma).sum()) + rows.cost


def _step(
    state: State, ties: Terms, rows: Rows, sigma: float, prior: Prior, damping: float
) -> tuple[State, float]:
    """Return the state a step further, and what the cost should gain by it."""
    system = system_of(state.block, ties, sigma, prior, state.values, damping)
    matrix, gradient = _together(system, rows)
    move = -solution(matrix, gradient, damping)
    own = np.einsum("pij,pj->pi", system.factors, system.right)
    count = len(system.gradient)
    block, values = moved(state.block, state.values, system, move[:count])
    points = state.points + move[count:].reshape(-1, 3)
    return State(block, state.cameras, values, points), float(-gradient @ move + (own**2).sum())


def _together(system: System, rows: Rows) -> tuple[F64, F64]:
    """Return the normal equations of all unknowns, (C, C) and (C,), tie points eliminated."""
    matrix = rows.jacobian.T @ rows.jacobian
    gradient = rows.jacobian.T @ rows.residuals
    count = len(system.gradient)
    matrix[:count, :count] += system.matrix
    gradient[:count] += system.gradient
    return matrix, gradient


def _normal_matrix(state: State, terms: ControlTerms, prior: Prior, sigma: float) -> F64:
    ties = derivatives(state.block, state.cameras, state.values)
    system = system_of(state.block, ties, sigma, prior, state.values, 0.0)
    return _together(system, rows_of(terms, state.block, state.cameras, state.values, state.points))[0]
