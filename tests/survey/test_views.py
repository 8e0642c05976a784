"""Rays and projections of photographs in a model."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from colmap_ihe.survey.observations import Observation
from colmap_ihe.survey.views import View, view_of


@pytest.fixture
def view() -> View:
    pycolmap.set_random_seed(3)
    model = pycolmap.synthesize_dataset(pycolmap.SyntheticDatasetOptions(num_frames_per_rig=2))
    image = sorted(image.name for image in model.images.values())[0]
    seen = view_of(model, Observation(image, "P", 700.25, 250.5, 0.3))
    assert seen is not None
    assert view_of(model, Observation("nowhere.jpg", "P", 1, 1, 0.3)) is None
    return seen


def test_a_ray_leads_to_where_the_point_was_seen(view: View) -> None:
    ray = view.ray()
    assert ray is not None
    assert np.linalg.norm(ray) == pytest.approx(1)
    points = view.centre + np.outer((3.0, 7.0, -4.0), ray)
    residuals = view.residuals(points)
    np.testing.assert_allclose(residuals[:2], 0, atol=1e-6)
    assert np.isinf(residuals[2]).all()  # behind the camera


def test_derivatives_tell_how_residuals_change(view: View) -> None:
    ray = view.ray()
    assert ray is not None
    point, step = view.centre + 5 * ray, np.array((0.01, -0.02, 0.015))
    change = view.residuals((point + step)[None]) - view.residuals(point[None])
    np.testing.assert_allclose(change[0], view.derivatives(point) @ step, rtol=0.02)
