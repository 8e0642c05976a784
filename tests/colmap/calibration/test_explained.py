"""How many matches of an image agree with where it is."""

from __future__ import annotations

import numpy as np
import pytest
from wall_survey import camera, survey, triangulation_of

from colmap_ihe.colmap.calibration.explained import least_explained
from colmap_ihe.colmap.native import pycolmap


def test_all_matches_agree_with_the_true_cameras_and_places() -> None:
    truth = survey(
        [camera(), camera("OPENCV_FISHEYE", (716, 716, 600, 450, 0.02, 0, 0, 0), camera_id=2)], 6, noise=0.3
    )
    assert least_explained(truth, triangulation_of(truth).graph, 4.0) == 1


def test_a_share_as_large_as_the_matches_that_are_wrong_does_not() -> None:
    model = survey([camera()], 6, wrong=0.2)
    share = least_explained(model, triangulation_of(model).graph, 4.0)
    assert share == pytest.approx(
        0.8**2, abs=0.12
    )  # both ends of a match must be right, or lie along the line


def test_an_image_that_was_turned_aside_agrees_with_few() -> None:
    model = survey([camera()], 6)
    image = model.images[3]
    assert image.frame is not None
    turned = (
        pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.05, 0.05, 0])), np.zeros(3)) * image.cam_from_world()
    )
    image.frame.set_cam_from_world(1, turned)
    assert least_explained(model, triangulation_of(model).graph, 4.0) < 0.3


def test_one_image_of_twelve_may_be_aside() -> None:
    model = survey([camera()], 12)
    for number, agrees in ((3, True), (9, False)):
        image = model.images[number]
        assert image.frame is not None
        aside = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.05, 0.05, 0])), np.zeros(3))
        image.frame.set_cam_from_world(1, aside * image.cam_from_world())
        assert (least_explained(model, triangulation_of(model).graph, 4.0) > 0.5) == agrees


def test_without_matches_nothing_disagrees() -> None:
    model = survey([camera()], 3)
    graph = pycolmap.CorrespondenceGraph()
    for image_id in sorted(model.images):
        graph.add_image(image_id, len(model.images[image_id].points2D))
    graph.finalize()
    assert least_explained(model, graph, 4.0) == 1
