"""Weights and costs by Huber, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.colmap.calibration.robust import deviation_of, robust_cost, weights_of

RESIDUALS = np.array([[0.0, 0.0], [0.3, 0.4], [3.0, 4.0], [np.nan, np.nan]])


def test_weights_fall_from_one_and_a_half_standard_deviations_on() -> None:
    assert weights_of(RESIDUALS, 0.5) == pytest.approx([1, 1, 1.5 / 10, 0])


def test_the_cost_is_quadratic_and_then_grows_evenly() -> None:
    assert robust_cost(RESIDUALS, 0.5) == pytest.approx([0, 1, 1.5 * (20 - 1.5), 1.5 * (200 - 1.5)])
    near = np.array([[1.5 - 1e-9, 0], [1.5 + 1e-9, 0]])
    below, above = robust_cost(near, 1.0)
    assert above - below == pytest.approx(2 * 1.5 * 2e-9, rel=1e-3)  # no step, no kink


def test_the_deviation_is_that_of_the_right_observations() -> None:
    rng = np.random.default_rng(1)
    residuals = 0.4 * rng.normal(size=(20_000, 2))
    assert deviation_of(residuals, 1.0) == pytest.approx(0.4, rel=0.02)
    residuals[:600] = 50
    residuals[600:800] = np.nan
    assert deviation_of(residuals, 1.0) == pytest.approx(0.4, rel=0.07)
    assert deviation_of(residuals, 0.25) == pytest.approx(0.8, rel=0.07)


def test_without_observations_or_errors_there_is_still_a_deviation() -> None:
    assert deviation_of(np.full((5, 2), np.nan), 0.5) == pytest.approx(1 / np.sqrt(0.5))
    assert deviation_of(np.zeros((5, 2)), -1.0) == pytest.approx(1e-3 / np.sqrt(0.05))
