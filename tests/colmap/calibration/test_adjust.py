"""Adjustments end at the truth that a scene is made of."""

from __future__ import annotations

import numpy as np
import pytest
from running import StopsWhen
from wall_survey import camera, given_cameras, moved_a_little, survey, whole_block

from colmap_ihe.colmap.calibration import adjust as module
from colmap_ihe.colmap.calibration.adjust import Adjusted, adjust, cleaned, place, residuals_of
from colmap_ihe.colmap.calibration.block import Block, Float64
from colmap_ihe.colmap.calibration.equations import Prior, System, covariance, solve, system_of
from colmap_ihe.colmap.calibration.lens import FreeCamera, derivatives, tied
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import Cancelled
from colmap_ihe.machine import threads

TRUTH = (1000, 611, 443, -0.05)
START = (1030, 600, 450, 0.0)
NOTHING = Prior(np.zeros(4), np.full(4, np.inf))


def perturbed(
    noise: float = 0.0, wrong: float = 0.0, start: tuple[float, ...] = START
) -> tuple[Block, FreeCamera]:
    model = survey([camera(params=TRUTH)], 8, noise=noise, wrong=wrong)
    given_cameras(model, [camera(params=start)])
    moved_a_little(model)
    block, (lens,) = whole_block(model)
    return block, FreeCamera(lens, tied(lens, [1, 2, 3]))


def test_an_exact_lens_is_found() -> None:
    block, free = perturbed()
    found = adjust(block, [free], np.zeros(4), NOTHING)
    np.testing.assert_allclose(free.at(found.values).params, TRUTH, rtol=1e-6)
    assert np.abs(found.residuals).max() < 1e-3
    assert found.sigma < 0.01


def deviations(found: Adjusted, free: FreeCamera) -> Float64:
    """(4,): of the parameters of the lens, which are all free, in their order."""
    terms = derivatives(found.block, [free], found.values)
    system = system_of(found.block, terms, found.sigma, NOTHING, found.values, 0.0)
    return np.sqrt(np.diag(covariance(found.block, system)))


def test_with_wrong_observations_it_is_found_within_its_deviations() -> None:
    block, free = perturbed(noise=0.3, wrong=0.05)
    found = adjust(block, [free], np.zeros(4), NOTHING)
    off = np.abs(np.asarray(free.at(found.values).params) - TRUTH)
    assert (off < 3 * deviations(found, free)).all()
    assert off[0] < 5
    assert found.sigma == pytest.approx(0.3, rel=0.25)


def test_what_is_held_does_not_move() -> None:
    start = (1000.1, 17.3, 450.7, -0.0501)
    block, free = perturbed(noise=0.2, start=start)
    held = FreeCamera(free.camera, np.zeros((4, 0)))
    found = adjust(block, [held], np.zeros(0), Prior(np.zeros(0), np.zeros(0)))
    assert held.at(found.values).params.tolist() == list(start)
    focal_alone = FreeCamera(free.camera, tied(free.camera, []))
    found = adjust(block, [focal_alone], np.zeros(1), Prior(np.zeros(1), np.full(1, np.inf)))
    assert focal_alone.at(found.values).params[1:].tolist() == list(start[1:])
    assert found.values[0] != 0


def test_a_prior_holds_as_far_as_it_is_sure() -> None:
    block, free = perturbed(noise=0.3)
    sure = Prior(np.zeros(4), np.array([1e-3, np.inf, np.inf, np.inf]))
    unsure = Prior(np.zeros(4), np.array([300, np.inf, np.inf, np.inf]))
    assert adjust(block, [free], np.zeros(4), sure).values[0] == pytest.approx(0, abs=0.01)
    found = adjust(block, [free], np.zeros(4), unsure)
    assert found.values[0] == pytest.approx(-30, abs=3)
    assert found.prior_cost == pytest.approx((found.values[0] / 300) ** 2)


def test_no_equations_are_set_up_after_a_step_that_leaves_nothing_to_gain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gains: list[float] = []

    def noted(system: System, damping: float) -> tuple[Float64, float]:
        move, gain = solve(system, damping)
        gains.append(gain)
        return move, gain

    monkeypatch.setattr(module, "solve", noted)
    block, free = perturbed(noise=0.3)
    found = adjust(block, [free], np.zeros(4), NOTHING)
    assert 1 <= gains[-1] < min(2, gains[-2] / 2)
    gains.clear()
    adjust(found.block, [free], found.values, NOTHING)
    assert len(gains) == 1
    assert gains[0] < 1  # by a step that is not made

    gains.clear()  # with wrong observations a step may gain nearly as much as the one before
    block, free = perturbed(noise=0.3, wrong=0.05)
    adjust(block, [free], np.zeros(4), NOTHING)
    assert gains[-1] < 1 <= gains[-2] < 2


def test_one_thread_gives_the_same_twice() -> None:
    block, free = perturbed(noise=0.3, wrong=0.05)
    with threads.limited(1):
        first, second = (adjust(block, [free], np.zeros(4), NOTHING) for _ in range(2))
    assert first.values.tobytes() == second.values.tobytes()
    assert first.block.points.tobytes() == second.block.points.tobytes()
    assert first.block.rotations.tobytes() == second.block.rotations.tobytes()


def test_an_adjustment_stops_when_it_is_told_to() -> None:
    block, free = perturbed(noise=0.3)
    asked: list[int] = []

    def at_the_third(done: int) -> bool:
        asked.append(done)
        return len(asked) == 3

    with pytest.raises(Cancelled):
        adjust(block, [free], np.zeros(4), NOTHING, progress=StopsWhen(at_the_third))
    assert len(asked) == 3


def test_a_start_that_is_far_off_never_makes_it_worse() -> None:
    model = survey([camera(params=TRUTH)], 8, noise=0.3, wrong=0.1)
    given_cameras(model, [camera(params=(400, 600, 450, 0))])
    moved_a_little(model, 0.2)  # by 1.6 of the 8 to the wall: a whole step is too far, and is not taken
    block, (lens,) = whole_block(model)
    free = FreeCamera(lens, tied(lens, [1, 2, 3]))
    steps = [adjust(block, [free], np.zeros(4), NOTHING, most=most, sigma=1.0) for most in range(0, 15, 2)]
    costs = [step.cost(1.0) for step in steps]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0] / 20


def test_points_come_to_where_their_observations_are() -> None:
    model = survey([camera(params=TRUTH)], 8)
    block, (lens,) = whole_block(model)
    away = np.random.default_rng(1).normal(size=block.points.shape)
    moved = Block(**{**vars(block), "points": block.points + 0.1 * away})
    np.testing.assert_allclose(place(moved, [lens], 0.3).points, block.points, atol=1e-4)


def test_points_behind_all_cameras_stay_where_they_are_and_are_cleaned_away() -> None:
    model = survey([camera(params=TRUTH)], 8, noise=0.2)
    gone = sorted(model.points3D)[::7]
    for point_id in gone:
        model.points3D[point_id].xyz = (0, 0, -40)
    block, (lens,) = whole_block(model)
    behind = block.points[:, 2] == -40
    assert np.isnan(residuals_of(block, [lens])[behind[block.point]]).all()
    assert (place(block, [lens], 0.3).points[behind] == (0, 0, -40)).all()
    _, points = cleaned(block, [lens], 0.3)
    assert set(points.tolist()) == set(np.flatnonzero(~behind).tolist())
    found = adjust(block, [FreeCamera(lens, tied(lens, [1, 2, 3]))], np.zeros(4), NOTHING)
    assert found.values == pytest.approx([0] * 4, abs=2)


def test_wrong_observations_are_cleaned_away_and_right_ones_are_not() -> None:
    model = survey([camera(params=TRUTH)], 8, noise=0.2, wrong=0.04)
    block, (lens,) = whole_block(model)
    residuals = residuals_of(block, [lens])  # from the true poses and points
    wrong = np.hypot(*residuals.T) > 10
    less, _ = cleaned(block, [lens], 0.2)
    left = {tuple(pixel) for pixel in less.pixels.tolist()}
    were = np.array([tuple(pixel) in left for pixel in block.pixels.tolist()])
    long = (np.diff(block.starts) > 4)[block.point]
    assert wrong.sum() > 20
    assert not were[wrong & long].any()
    assert were[~wrong].mean() > 0.9


def test_a_camera_without_observations_and_one_of_few_are_no_obstacle() -> None:
    block, free = perturbed(noise=0.2)
    order = np.cumsum(block.image == 5)
    less, _ = block.of_observations((block.image != 2) & ((block.image != 5) | (order < 3)))
    found = adjust(less, [free], np.zeros(4), NOTHING)
    assert free.at(found.values).params == pytest.approx(TRUTH, rel=2e-2)
    np.testing.assert_array_equal(found.block.translations[2], less.translations[2])
    other = pycolmap.Camera(free.camera.todict())
    both = [
        FreeCamera(one, np.hstack([basis, rest]))
        for one, basis, rest in (
            (free.camera, free.basis, np.zeros((4, 1))),
            (other, np.zeros((4, 4)), tied(other, [])),
        )
    ]
    found = adjust(less, both, np.zeros(5), Prior(np.zeros(5), np.full(5, np.inf)))
    assert found.values[4] == 0
    assert both[0].at(found.values).params == pytest.approx(TRUTH, rel=2e-2)
