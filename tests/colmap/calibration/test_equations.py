"""Normal equations with points eliminated, beside dense ones over all parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from wall_survey import camera, moved_a_little, survey, whole_block

from colmap_ihe.colmap.calibration.block import Block
from colmap_ihe.colmap.calibration.equations import (
    Prior,
    System,
    covariance,
    inverse_of,
    moved,
    solve,
    solved,
    system_of,
    without_poses,
)
from colmap_ihe.colmap.calibration.lens import FreeCamera, derivatives, tied
from colmap_ihe.colmap.calibration.robust import HUBER
from colmap_ihe.colmap.native import pycolmap

Float64 = NDArray[np.float64]
SIGMA = 0.4
PRIOR = Prior(np.array([3.0, 0, 0, 0.01]), np.array([20.0, np.inf, 5, 0.05]))


def tiny(noise: float = SIGMA, points: int = 60, images: int = 4) -> tuple[Block, list[FreeCamera]]:
    model = survey([camera()], images, points=points, noise=noise, wrong=0.03)
    moved_a_little(model, 1e-4)
    block, cameras = whole_block(model)
    return block, [FreeCamera(cameras[0], tied(cameras[0], [1, 2, 3]))]


def weighted_residuals(block: Block, free: list[FreeCamera], change: Float64, weights: Float64) -> Float64:
    """All residuals, of the priors with them, after a change of six of each pose, K free parameters, 3 of each point;
    by COLMAP's own poses."""
    images, count = len(block.rotations), free[0].basis.shape[1]
    poses = change[: 6 * images].reshape(-1, 6)
    values, points = change[6 * images :][:count], block.points + change[6 * images + count :].reshape(-1, 3)
    pixels = np.zeros_like(block.pixels)
    for image in range(images):
        mine = block.image == image
        turn = pycolmap.Rotation3d(poses[image, :3]).matrix()
        at = points[block.point[mine]] @ block.rotations[image].T @ turn.T
        at += block.translations[image] + poses[image, 3:]
        pixels[mine] = free[0].at(values).img_from_cam(at)
    observed = (pixels - block.pixels) * np.sqrt(weights)[:, None] / SIGMA
    return np.concatenate([observed.ravel(), (values - PRIOR.mean) / PRIOR.deviation])


def dense(block: Block, free: list[FreeCamera]) -> tuple[Float64, Float64]:
    """Derivatives (n, C + 3P), by numeric differences, and residuals (n,)."""
    images, count = len(block.rotations), free[0].basis.shape[1]
    size = 6 * images + count + 3 * len(block.points)
    plain = weighted_residuals(block, free, np.zeros(size), np.ones(len(block.pixels)))[
        : 2 * len(block.pixels)
    ]
    away = np.linalg.norm(plain.reshape(-1, 2), axis=1)
    weights = np.where(away > HUBER, HUBER / np.maximum(away, HUBER), 1.0)
    assert 1 < np.sum(weights < 1) < len(weights) / 2
    columns = []
    for index in range(size):
        step = np.zeros(size)
        step[index] = 1e-3 if 6 * images <= index < 6 * images + 3 else 1e-6
        ahead, behind = (weighted_residuals(block, free, sign * step, weights) for sign in (1, -1))
        columns.append((ahead - behind) / (2 * step[index]))
    return np.column_stack(columns), weighted_residuals(block, free, np.zeros(size), weights)


def system(block: Block, free: list[FreeCamera], prior: Prior = PRIOR) -> System:
    values = np.zeros(free[0].basis.shape[1])
    return system_of(block, derivatives(block, free, values), SIGMA, prior, values, 0.0)


def test_a_step_is_that_of_dense_least_squares() -> None:
    block, free = tiny()
    jacobian, residuals = dense(block, free)
    step = np.linalg.lstsq(jacobian, -residuals, rcond=1e-10)[0]
    equations = system(block, free)
    move, gain = solve(equations, 0.0)
    ahead, values = moved(block, np.zeros(4), equations, move)
    tail = slice(6 * len(block.rotations), len(move))
    np.testing.assert_allclose(values, step[tail], rtol=1e-4)
    # Another gauge, so what poses and points come to is compared by what they show.
    own = np.concatenate([move, (ahead.points - block.points).ravel()])
    np.testing.assert_allclose(jacobian @ own, jacobian @ step, atol=1e-3)
    assert gain == pytest.approx(residuals @ residuals - np.sum((residuals + jacobian @ step) ** 2), rel=1e-4)


def test_poses_move_as_the_step_says() -> None:
    block, free = tiny()
    equations = system(block, free)
    move = 1e-3 * np.random.default_rng(1).normal(size=len(equations.gradient))
    ahead, _ = moved(block, np.zeros(4), equations, move)
    for image, (turn, shift) in enumerate(move[:24].reshape(-1, 2, 3)):
        np.testing.assert_allclose(
            ahead.rotations[image], pycolmap.Rotation3d(turn).matrix() @ block.rotations[image]
        )
        np.testing.assert_allclose(ahead.translations[image], block.translations[image] + shift)


def test_the_inverse_is_the_dense_one() -> None:
    block, free = tiny()
    jacobian, _ = dense(block, free)
    inverse = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-13, hermitian=True)
    tail = slice(6 * len(block.rotations), 6 * len(block.rotations) + 4)
    equations = system(block, free)
    np.testing.assert_allclose(inverse_of(equations)[tail], inverse[tail, tail], rtol=1e-3)
    matrix, gradient = without_poses(equations)
    np.testing.assert_allclose(np.linalg.inv(matrix), inverse[tail, tail], rtol=1e-3)
    move, _ = solve(equations, 0.0)
    np.testing.assert_allclose(np.linalg.solve(matrix, -gradient), move[tail], rtol=1e-3)


def test_with_independent_errors_the_covariance_is_the_inverse() -> None:
    model = survey([camera()], 8, points=500, noise=SIGMA)
    block, cameras = whole_block(model)
    equations = system(block, [FreeCamera(cameras[0], tied(cameras[0], [1, 2, 3]))])
    plain, robust = (np.sqrt(np.diag(m)) for m in (inverse_of(equations)[-4:], covariance(block, equations)))
    assert (robust >= plain * (1 - 1e-9)).all()
    assert (robust < 1.3 * plain).all()


def test_where_errors_are_alike_in_a_part_of_the_picture_less_is_certain() -> None:
    model = survey([camera()], 8, points=500, noise=SIGMA)
    block, cameras = whole_block(model)
    free = [FreeCamera(cameras[0], tied(cameras[0], [1, 2, 3]))]
    shift = 0.8 * np.sin(block.pixels / 120)
    plain = np.diag(covariance(block, system(block, free)))
    alike = replace(block, pixels=block.pixels + shift)
    assert (np.diag(covariance(alike, system(alike, free)))[[0, 3]] > 2 * plain[[0, 3]]).all()


def test_a_prior_counts_as_an_observation() -> None:
    block, free = tiny()
    loose, tight = (Prior(np.full(4, 2.0), np.array([d, np.inf, np.inf, np.inf])) for d in (np.inf, 1e-3))
    assert (loose.cost(np.zeros(4)), tight.cost(np.zeros(4))) == (0, 4e6)
    free_move, held_move = (solve(system(block, free, prior), 0.0)[0][-4] for prior in (loose, tight))
    assert abs(free_move - 2) > 0.1
    assert held_move == pytest.approx(2, abs=1e-3)


def test_with_nothing_of_the_cameras_free_poses_are_solved_alone() -> None:
    block, free = tiny()
    held = [FreeCamera(free[0].camera, np.zeros((4, 0)))]
    equations = system(block, held, Prior(np.zeros(0), np.zeros(0)))
    move, gain = solve(equations, 0.0)
    assert move.shape == (24,)
    assert gain > 0
    assert covariance(block, equations).shape == (0, 0)


def test_of_a_block_without_observations_the_priors_are_left() -> None:
    block, free = tiny()
    empty, _ = block.of_observations(np.zeros(len(block.pixels), bool))
    prior = Prior(np.array([1.0, 2, 3, 0.5]), np.array([2.0, 3, 4, 0.1]))
    equations = system(empty, free, prior)
    assert solve(equations, 0.0)[0][-4:] == pytest.approx(prior.mean)
    assert covariance(empty, equations) == pytest.approx(np.diag(prior.deviation**2))


def test_singular_equations_have_the_shortest_solution() -> None:
    assert solved(np.ones((2, 2)), np.array([2.0, 2.0])) == pytest.approx([1, 1])
    assert solved(np.diag([2.0, 0]), np.eye(2)) == pytest.approx(np.diag([0.5, 0]))
