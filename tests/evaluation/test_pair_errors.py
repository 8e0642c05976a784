"""Pairs: efficiency, movement of the camera, relative errors."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from colmap_ihe.evaluation import pair_errors
from colmap_ihe.evaluation.pair_errors import PairMatches
from colmap_ihe.evaluation.truth import F64


def pose(turn_deg: tuple[float, ...] = (0, 0, 0), centre: tuple[float, ...] = (0, 0, 0)) -> F64:
    rotation, _ = cv2.Rodrigues(np.radians(np.array(turn_deg, float)))
    return np.column_stack([rotation, -rotation @ np.array(centre, float)])


def test_efficiency_is_over_all_matches_and_not_the_mean_of_pairs() -> None:
    assert pair_errors.efficiency_percent([PairMatches(100, 50), PairMatches(300, 270)]) == 80
    assert pair_errors.efficiency_percent([]) is None
    assert pair_errors.efficiency_percent([PairMatches(0, 0)]) is None


@pytest.mark.parametrize(
    ("turn", "kind"),
    [
        ((0, 0, 0), "parallel"), ((3, 4, 2), "parallel"), ((0, 20, 0), "rotated"),
        ((0, 0, 90), "rotated"), ((15, 4, 1), "tilted"), ((-15, 0, 0), "tilted"),
    ],
)  # fmt: skip
def test_movements_are_told_apart(turn: tuple[float, float, float], kind: str) -> None:
    assert pair_errors.movement(pose((5, 5, 0)), pose((5, 5, 0), (1, 0, 0))) == "parallel"
    assert pair_errors.movement(pose(), pose(turn, (2, 1, 0))) == kind


def test_relative_errors_do_not_see_the_frame_of_the_model() -> None:
    true = {f"{n}": pose((0, 5 * n, 0), (n, 0, 0.1 * n * n)) for n in range(4)}
    frame = pose((30, -20, 10), (5, 6, 7))
    moved = {}
    for key, value in true.items():
        rotation = value[:, :3] @ frame[:, :3]
        moved[key] = np.column_stack([rotation, 3 * (value[:, :3] @ frame[:, 3] + value[:, 3])])
    assert pair_errors.relative_errors_deg(moved, true).max() < 1e-4
    turned = dict(true) | {"2": pose((0, 12, 0), (2, 0, 0.4))}
    errors = pair_errors.relative_errors_deg(turned, true)
    assert len(errors) == 6
    assert np.sum(errors > 1) == 3
    assert errors.max() == pytest.approx(2, abs=0.01)
    del turned["2"]
    assert np.sum(pair_errors.relative_errors_deg(turned, true) == 180) == 3


def test_the_area_under_the_curve() -> None:
    assert pair_errors.area_under_curve_percent(np.zeros(5), 5) == 100
    assert pair_errors.area_under_curve_percent(np.array([0.0, 2.5, 5, 180]), 5) == pytest.approx(37.5)
    errors, steps = np.array([0.3, 1.7, 4.0, 9.0]), np.linspace(0, 5, 100_001)
    curve = (errors[None] <= steps[:, None]).mean(axis=1)
    assert pair_errors.area_under_curve_percent(errors, 5) == pytest.approx(100 * curve.mean(), abs=0.01)
    assert math.isnan(pair_errors.area_under_curve_percent(np.empty(0), 5))
