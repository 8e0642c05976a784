"""The similarity from a model to its survey, and what does not fit it."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.similarity import Similarity, fitted, in_a_line

TURN = np.asarray(pycolmap.Rotation3d(np.array((0.2, -0.7, 1.9))).matrix())
TRUTH = Similarity(2.5, TURN, np.array((10.0, -3.0, 7.0)))


def cloud(count: int, noise_m: float = 0.002) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    draw = np.random.default_rng(count)
    model = draw.uniform(-2, 2, (count, 3))
    return model, TRUTH(model) + draw.normal(0, noise_m, (count, 3)), np.full(count, noise_m)


def test_the_similarity_of_exact_points_is_the_truth() -> None:
    model, _, accuracy = cloud(5)
    fit = fitted(model, TRUTH(model), accuracy)
    assert fit.similarity is not None
    np.testing.assert_allclose(fit.similarity.matrix(), TRUTH.matrix(), atol=1e-9)


@pytest.mark.parametrize("count", [5, 8, 30])
def test_a_point_off_by_a_metre_is_found_and_bends_nothing(count: int) -> None:
    model, surveyed, accuracy = cloud(count)
    surveyed[2, 0] += 1.0
    fit = fitted(model, surveyed, accuracy)
    assert fit.fits.tolist() == [n != 2 for n in range(count)]
    assert fit.similarity is not None
    assert fit.similarity.scale == pytest.approx(2.5, rel=2e-3)
    assert fit.distances[2] == pytest.approx(1.0, abs=0.02)


def facade(seed: int, bent_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Five points of a facade 12 m wide, surveyed to 1 mm, in a model of which the ends are bent by `bent_m`."""
    draw = np.random.default_rng(seed)
    true = draw.uniform((-6, -1, 0), (6, 0, 6), (5, 3))
    model = true.copy()
    model[:, 1] += bent_m * (true[:, 0] / 6) ** 2
    return model / 1.7, true + draw.normal(0, 0.001, (5, 3)), np.full(5, 0.001)


def test_of_five_good_points_none_is_left_out() -> None:
    assert all(fitted(*facade(seed, 0.0)).fits.all() for seed in range(40))


def test_a_bent_model_makes_no_point_wrong_and_hides_none_that_is() -> None:
    for seed in range(20):
        model, surveyed, accuracy = facade(seed, 0.03)
        assert fitted(model, surveyed, accuracy, bent_m=0.03).fits.all()
        surveyed[2, 2] += 1.0
        assert not fitted(model, surveyed, accuracy, bent_m=0.03).fits[2]


def test_two_exchanged_points_are_found() -> None:
    model, surveyed, accuracy = cloud(8)
    surveyed[[1, 4]] = surveyed[[4, 1]]
    assert np.flatnonzero(~fitted(model, surveyed, accuracy).fits).tolist() == [1, 4]


def test_points_in_a_line_need_to_know_what_is_up() -> None:
    model = np.stack([np.array((x, 0.5 * x, 0.0)) for x in range(5)])
    accuracy = np.full(5, 0.01)
    assert in_a_line(model)
    assert "in a line" in fitted(model, TRUTH(model), accuracy).failure
    upright = Similarity(2.0, np.eye(3), np.zeros(3))
    fit = fitted(model, upright(model), accuracy, up=np.array((0.0, 0.0, 1.0)))
    assert fit.similarity is not None
    np.testing.assert_allclose(fit.similarity.matrix(), upright.matrix(), atol=1e-6)


def test_points_of_another_building_are_refused() -> None:
    draw = np.random.default_rng(3)
    fit = fitted(draw.uniform(0, 1, (6, 3)), draw.uniform(0, 10, (6, 3)), np.full(6, 0.01))
    assert fit.similarity is None
    assert "agree" in fit.failure


def test_two_points_are_too_few() -> None:
    model, surveyed, accuracy = cloud(2)
    assert fitted(model, surveyed, accuracy).failure == "2 of at least 3 are there"
