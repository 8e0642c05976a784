"""Which control points do not fit an adjustment in which they took part."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from colmap_ihe.survey.control_fit import ControlFit

SIGMA = 0.001


def adjusted(count: int, seed: int, errors_m: Mapping[int, float]) -> ControlFit:
    """Points of a facade to 1 mm, some off by `errors_m` upwards, in a rigid model that least squares place."""
    draw = np.random.default_rng(seed)
    points = draw.uniform((-6, -1, 0), (6, 0, 6), (count, 3))
    design = np.concatenate([_slopes(point) for point in points - points.mean(axis=0)])
    placed = design @ np.linalg.inv(design.T @ design) @ design.T
    errors = draw.normal(0, SIGMA, (count, 3))
    for number, error in errors_m.items():
        errors[number, 2] += error
    deltas = (placed @ errors.ravel() - errors.ravel()).reshape(count, 3)
    covariances = SIGMA**2 * np.array([placed[k : k + 3, k : k + 3] for k in range(0, 3 * count, 3)])
    return ControlFit([f"T{n}" for n in range(count)], deltas, np.full(count, SIGMA), covariances)


def _slopes(point: np.ndarray) -> np.ndarray:
    """(3, 7): a point's place by translation, rotation and scale."""
    x, y, z = point
    return np.column_stack((np.eye(3), np.array(((0, -z, y), (z, 0, -x), (-y, x, 0))), point))


def test_what_is_left_of_good_points_is_as_long_as_it_should_be() -> None:
    squares = [np.mean(adjusted(6, seed, {}).in_deviations() ** 2) for seed in range(200)]
    assert np.mean(squares) == pytest.approx(3, rel=0.1)


def test_good_points_are_not_wrong_and_raise_no_doubt() -> None:
    fits = [adjusted(count, seed, {}) for count in (4, 5, 8) for seed in range(100)]
    assert sum(fit.wrong() is not None for fit in fits) <= 3
    assert not any(fit.doubt() for fit in fits)


def test_one_of_five_that_is_off_by_twenty_accuracies_is_found_and_how_far_it_is() -> None:
    found = [adjusted(5, seed, {seed % 5: 20 * SIGMA}).wrong() for seed in range(40)]
    right = [wrong is not None and wrong[0] == f"T{seed % 5}" for seed, wrong in enumerate(found)]
    assert sum(right) >= 38
    wrong = adjusted(12, 0, {3: 0.05}).wrong()
    assert wrong is not None
    name, away = wrong
    assert name == "T3"
    assert away.endswith(" mm from where the others put it")
    assert 35 < float(away.split()[0]) <= 50


def test_the_worst_of_two_that_are_wrong_is_found_though_the_other_spoils_the_mean() -> None:
    for seed in range(20):
        wrong = adjusted(9, seed, {1: 0.05, 4: -0.08}).wrong()
        assert wrong is not None
        assert wrong[0] in ("T1", "T4")


def test_where_no_point_stands_out_a_doubt_names_the_first_to_look_at() -> None:
    fits = [adjusted(5, seed, {1: 0.05, 4: 0.05}) for seed in range(40)]
    doubts = [fit.doubt() for fit in fits if fit.wrong() is None]
    assert len(doubts) > 5
    assert all("it cannot be told which of them is wrong; T" in doubt for doubt in doubts)


def test_of_three_points_none_can_be_told_to_be_wrong() -> None:
    fit = adjusted(3, 0, {1: 1.0})
    assert (fit.wrong(), fit.doubt()) == (None, "")
