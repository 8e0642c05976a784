"""Turns on the spot and steps to the side, seen through lenses of several models."""

from __future__ import annotations

import numpy as np
import pytest
from lenses import SIZE, Lens, fisheye

from colmap_ihe.colmap.checks.camera_motion import TURNED_DEGREES, parallax_of


@pytest.mark.parametrize("step", [0.0, 0.8])
@pytest.mark.parametrize(
    "lens",
    [
        Lens("OPENCV", (200, 203), (-0.12, 0.03, 0.002, -0.001)),
        fisheye(120),
        fisheye(120, "RADIAL_FISHEYE", (-0.02, 0.004)),
    ],
    ids=lambda lens: str(lens.model),
)
def test_parallax_is_that_between_the_true_rays(lens: Lens, step: float) -> None:
    angle = np.radians(20)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    points = np.random.default_rng(1).uniform((-6, -3, 4), (6, 3, 8), (3000, 3))
    places = [lens.pixels(points), lens.pixels((points - (step, 0, 0)) @ turn.T)]
    seen = np.all([(p > 0) & (p < SIZE) for p in places], axis=(0, 2))
    assert seen.sum() > 300
    noise = np.random.default_rng(2).normal(0, 0.1, (2, seen.sum(), 2))
    camera = lens.camera(1)
    camera.has_prior_focal_length = True
    first, second = (place[seen] + error for place, error in zip(places, noise, strict=True))
    parallax, turned = parallax_of(first, second, camera, camera)
    assert (parallax < TURNED_DEGREES) == (step == 0)
    if step == 0:
        assert turned == pytest.approx(np.median(np.degrees(2 * np.arcsin(np.sin(angle / 2)))), rel=0.25)


def test_a_camera_that_tells_no_rays_counts_as_moved() -> None:
    camera = Lens("SIMPLE_RADIAL", (1, 1), (-0.3,)).camera(1)
    places = np.random.default_rng(0).uniform(0, 100, (50, 2))
    assert parallax_of(places, places, camera, camera) == (180, 180)
