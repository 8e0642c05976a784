"""What is expected of check points and cameras, against what they are off by in made-up surveys."""

from __future__ import annotations

import numpy as np
import pytest
from survey_block import FOCAL, HEIGHT, WIDTH, survey_block

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.adjustment import adjust_with_control
from colmap_ihe.survey.alignment import Survey
from colmap_ihe.survey.control import SurveyedPoint
from colmap_ihe.survey.control_equations import ControlTerms
from colmap_ihe.survey.georeference import georeference
from colmap_ihe.survey.spread import solution

TRUTH = np.array((FOCAL, WIDTH / 2 + 6, HEIGHT / 2 - 4, -0.03))
SURVEYED_M = 1e-4


def test_points_far_from_control_and_cameras_are_off_by_as_much_as_is_expected() -> None:
    points, cameras, sights_alone = [], [], []
    for seed in (0, 1, 2, 3, 5, 6):
        block = survey_block(8, 12, 60, seed=seed, noise_px=0.8)
        left = sorted(block.named, key=lambda name: float(block.named[name][0]))[:4]
        surveyed = {}
        for name, place in block.named.items():
            x, y, z = place.tolist()
            surveyed[name] = SurveyedPoint(
                name, (x, y, z), SURVEYED_M, "control" if name in left else "check"
            )
        model = pycolmap.Reconstruction(block.model)
        result = georeference(model, Survey(points=surveyed), block.sights, "auto", {1: [0, 1, 2, 3]})
        cameras.append((np.asarray(model.cameras[1].params) - TRUTH) / result.camera_deviations[1])
        assert result.triangulated is not None
        for point in (p for p in result.points if p.role == "check"):
            own = np.sqrt(np.diag(result.triangulated.points[point.name].covariance))
            away = np.asarray(point.delta_m)
            points.append(away / np.asarray(point.deviation_m))
            sights_alone.append(away / own)
    assert 0.6 < np.sqrt(np.mean(np.square(points))) < 1.4
    assert 0.6 < np.sqrt(np.mean(np.square(cameras))) < 1.5
    assert np.sqrt(np.mean(np.square(sights_alone))) > 4  # so it is the cameras that tell


def test_a_point_of_which_no_sight_counts_may_lie_anywhere() -> None:
    block = survey_block(4, 4, 60)
    model = pycolmap.Reconstruction(block.model)
    place = np.array([model.points3D[min(model.points3D)].xyz])
    none, numbers = np.zeros((0, 3)), np.zeros(0, np.intp)
    terms = ControlTerms(
        located=place,
        surveyed=place,
        accuracy_m=np.array([0.01]),
        image=numbers,
        point=numbers,
        pixels=np.zeros((0, 2)),
        accuracy_px=none[:, 0],
        ends=np.zeros((0, 2), np.intp),
        lengths=none[:, 0],
        bar_accuracy_m=none[:, 0],
        at=numbers,
        centres=none,
        centre_accuracy_m=none[:, 0],
    )
    spread = adjust_with_control(model, terms, {})
    assert (np.diag(spread.of_points_apart(terms)[0]) > 1e8).all()


def test_normal_equations_are_solved_in_directions_that_nothing_determines_too() -> None:
    matrix = np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    assert solution(matrix, np.array([3.0, 3.0, 0.0]), 0.0) == pytest.approx([1, 1, 0])
    assert solution(matrix, np.array([3.0, 3.0, 0.0]), 1.0)[0] < 0.9
