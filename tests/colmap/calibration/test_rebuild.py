"""A model that is given a calibration: its points follow, and its matches are triangulated by it."""

from __future__ import annotations

import time

import numpy as np
import pytest
from running import StopsWhen
from wall_survey import camera, given_cameras, moved_a_little, position_error, survey, triangulation_of

from colmap_ihe.colmap.calibration.block import Float64, Part, part_of
from colmap_ihe.colmap.calibration.choose import Chooser, Fit
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens
from colmap_ihe.colmap.calibration.rebuild import adjust_poses, give, triangulate
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.progress import SILENT

TRUTH = camera(params=(1000, 612, 447, -0.05))


def perturbed() -> tuple[pycolmap.Reconstruction, pycolmap.Reconstruction]:
    """The truth, and the same with a lens that is another and with poses and points moved."""
    truth = survey([TRUTH])
    model = pycolmap.Reconstruction(truth)
    given_cameras(model, [camera(params=(1005, 608, 450, -0.04))])
    moved_a_little(model, 5e-4)
    return truth, model


def fit_of(model: pycolmap.Reconstruction, image_ids: list[int]) -> tuple[Part, Fit]:
    part = part_of(model, image_ids, [1])
    chooser = Chooser(part.block, [model.cameras[1]])
    lenses = (Lens((0,), (0,), Freedom("RADIAL", 2, True)),)
    return part, chooser.fit(part.block, lenses, [model.cameras[1]])


def errors(model: pycolmap.Reconstruction) -> Float64:
    """(M,): the distance of each observation from its point, in pixels."""
    found = []
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        for observed in image.get_observation_points2D():
            at = image.cam_from_world() * model.points3D[observed.point3D_id].xyz
            pixel = model.cameras[image.camera_id].img_from_cam(at)
            found.append(np.inf if pixel is None else np.linalg.norm(pixel - observed.xy))
    return np.array(found)


def test_cameras_and_poses_are_given_and_points_follow() -> None:
    truth, model = perturbed()
    assert np.median(errors(model)) > 1
    part, fit = fit_of(model, list(range(1, 9)))
    give(model, part, fit.cameras, fit.adjusted.block, fit.adjusted.sigma)
    assert model.cameras[1].model_name == "RADIAL"
    assert model.cameras[1].params == pytest.approx((1000, 612, 447, -0.05, 0), rel=1e-3, abs=1e-3)
    assert np.max(errors(model)) < 0.02
    assert position_error(model, truth) < 1e-3


def test_of_more_images_those_of_the_fit_are_given_and_colmap_adjusts_the_others() -> None:
    truth, model = perturbed()
    others = {i: model.images[i].cam_from_world().matrix() for i in (7, 8)}
    part, fit = fit_of(model, list(range(1, 7)))
    give(model, part, fit.cameras, fit.adjusted.block, fit.adjusted.sigma)
    for image_id, pose in others.items():
        np.testing.assert_array_equal(model.images[image_id].cam_from_world().matrix(), pose)
    params = model.cameras[1].params.tolist()
    with quiet():
        adjust_poses(model, SILENT, 1)
    assert model.cameras[1].params.tolist() == params
    assert np.median(errors(model)) < 0.02
    assert position_error(model, truth) < 2e-3


def test_what_is_missing_is_triangulated_and_what_is_wrong_goes() -> None:
    truth = survey([TRUTH])
    triangulation = triangulation_of(truth)
    model = pycolmap.Reconstruction(truth)
    point_ids = sorted(i for i, p in model.points3D.items() if p.track.length() > 2)  # as COLMAP triangulates
    missing, short, wrong, behind = point_ids[:40], point_ids[40:60], point_ids[60:70], point_ids[70:75]
    for point_id in missing:
        model.delete_point3D(point_id)
    for point_id in short:
        element = model.points3D[point_id].track.elements[0]
        model.delete_observation(element.image_id, element.point2D_idx)
    for point_id in wrong:
        model.points3D[point_id].xyz = np.add(model.points3D[point_id].xyz, (0, 0, 2.0))
    for point_id in behind:
        model.points3D[point_id].xyz = (0, 0, -40)
    triangulate(model, triangulation)
    assert model.compute_num_observations() == truth.compute_num_observations()
    assert np.max(errors(model)) < 0.01
    found = np.array([p.xyz for p in model.points3D.values()])
    true = np.array([p.xyz for p in truth.points3D.values()])
    apart = np.linalg.norm(found[:, None] - true[None], axis=2)
    assert apart.min(axis=1).max() < 1e-4
    assert model.points3D[point_ids[-1]].error == pytest.approx(0, abs=1e-3)  # as COLMAP keeps it


def test_triangulation_stops_when_it_is_told_to() -> None:
    truth = survey([TRUTH])
    began = time.monotonic()
    with pytest.raises(Cancelled):
        triangulate(truth, triangulation_of(truth), StopsWhen(lambda _: True))
    assert time.monotonic() - began < 5
