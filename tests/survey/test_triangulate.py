"""Named points in a model: where they are, how well, and what is left out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pycolmap
import pytest

from colmap_ihe.survey.observations import Observation
from colmap_ihe.survey.triangulate import triangulate, triangulation

F64 = npt.NDArray[np.float64]
TRUE = np.array([0.3, -0.2, 0.1])


@pytest.fixture(scope="module")
def model() -> pycolmap.Reconstruction:
    """Ten photographs around the origin by two lenses that bend lines."""
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions(num_rigs=2, num_cameras_per_rig=1, num_frames_per_rig=5)
    options.camera_model_id = pycolmap.CameraModelId.SIMPLE_RADIAL
    return pycolmap.synthesize_dataset(options)


def sight(model: pycolmap.Reconstruction, image: str, point: F64, name: str = "P") -> Observation:
    seen = model.find_image_with_name(image)
    pixel = model.cameras[seen.camera_id].img_from_cam(seen.cam_from_world() * point)
    assert pixel is not None
    return Observation(image, name, float(pixel[0]), float(pixel[1]), 0.2)


def moved(one: Observation, dx: float, dy: float) -> Observation:
    return Observation(one.image, one.name, one.x_px + dx, one.y_px + dy, one.accuracy_px)


def names_of(model: pycolmap.Reconstruction) -> list[str]:
    return sorted(image.name for image in model.images.values())


def sights_of(model: pycolmap.Reconstruction, name: str = "P", point: F64 = TRUE) -> list[Observation]:
    return [sight(model, image, point, name) for image in names_of(model)]


def test_a_point_is_where_all_photographs_see_it(model: pycolmap.Reconstruction) -> None:
    point = triangulate(model, sights_of(model))["P"]
    np.testing.assert_allclose(point.xyz, TRUE, atol=1e-9)
    assert point.used == tuple(names_of(model))
    assert point.left_out == {}
    assert np.abs(list(point.residuals_px.values())).max() < 1e-6


def test_the_covariance_tells_how_the_point_scatters(model: pycolmap.Reconstruction) -> None:
    rng, offsets = np.random.default_rng(5), []
    exact = sights_of(model)
    for _ in range(100):
        noisy = [moved(one, *rng.normal(0, 0.2, 2)) for one in exact]
        offsets.append(triangulate(model, noisy)["P"].xyz - TRUE)
    predicted = triangulate(model, exact)["P"].covariance
    ratio = np.sqrt(np.diag(np.cov(np.array(offsets).T)) / np.diag(predicted))
    np.testing.assert_allclose(ratio, 1, atol=0.2)
    assert np.abs(np.mean(offsets, axis=0)).max() < 0.3 * np.sqrt(np.diag(predicted)).max()


def test_three_wrong_sights_of_ten_are_left_out_and_named(model: pycolmap.Reconstruction) -> None:
    sights = sights_of(model)
    for index, (dx, dy) in {1: (40.0, 3.0), 4: (-6.0, 2.5), 7: (300.0, -200.0)}.items():
        sights[index] = moved(sights[index], dx, dy)
    point = triangulate(model, sights)["P"]
    np.testing.assert_allclose(point.xyz, TRUE, atol=1e-8)
    assert sorted(point.left_out) == [names_of(model)[index] for index in (1, 4, 7)]
    assert point.left_out[names_of(model)[4]] == "6.5 px off, where 1.0 px is the limit"
    assert point.residuals_px[names_of(model)[4]] == pytest.approx((-6.0, 2.5), abs=1e-4)


def test_in_a_coarse_model_the_limit_is_wider(model: pycolmap.Reconstruction) -> None:
    rng = np.random.default_rng(2)
    sights = [moved(one, *rng.normal(0, 1.0, 2)) for k in range(6) for one in sights_of(model, f"P{k}")]
    points = triangulate(model, [*sights, *(moved(one, 2.5, 0) for one in sights_of(model, "Q")[:1])])
    assert [point.left_out for point in points.values()] == [{}] * 6
    spread = np.sqrt(np.diag(points["P0"].covariance))
    assert np.abs(points["P0"].xyz - TRUE).max() < 4 * spread.max()


def test_what_cannot_be_located_says_why(model: pycolmap.Reconstruction) -> None:
    images = names_of(model)
    elsewhere = np.array([-0.3, 0.3, -0.2])
    halves = [sight(model, image, TRUE, "half") for image in images[:5]]
    halves += [sight(model, image, elsewhere, "half") for image in images[5:]]
    twice = [sight(model, images[0], point, "twice") for point in (TRUE, elsewhere)]
    twice += [sight(model, images[1], TRUE, "twice")]
    apart = [sight(model, images[0], TRUE, "apart"), moved(sight(model, images[1], TRUE, "apart"), 0, 90)]
    absent = [Observation("nowhere.jpg", "absent", 5, 5, 0.2), sight(model, images[2], TRUE, "absent")]
    outcome = triangulation(model, [*halves, *twice, *apart, *absent, *sights_of(model, "good")])
    assert list(outcome.points) == ["good"]
    why = outcome.not_located
    assert why["half"].startswith("only 5 of the 10 photographs that see it agree on a place")
    assert why["twice"] == f"only {images[1]} sees it; a point needs two photographs"
    assert why["apart"].startswith(f"{images[0]}, {images[1]} disagree by ")
    assert why["absent"] == f"only {images[2]} sees it; a point needs two photographs"


def test_a_point_that_one_photograph_has_twice_is_left_out_there(model: pycolmap.Reconstruction) -> None:
    sights = sights_of(model)
    point = triangulate(model, [*sights, moved(sights[3], 50, 50)])["P"]
    np.testing.assert_allclose(point.xyz, TRUE, atol=1e-9)
    assert point.left_out == {sights[3].image: "seen 2 times in this photograph"}


def test_rays_that_hardly_meet_locate_nothing(model: pycolmap.Reconstruction) -> None:
    centres = {image.name: image.projection_center() for image in model.images.values()}
    first, second = names_of(model)[:2]
    middle = (centres[first] + centres[second]) / 2
    away = np.cross(centres[first] - centres[second], [0.2, 0.3, 0.9])
    far = middle - away / np.linalg.norm(away) * 300 * np.sign(away @ middle)
    outcome = triangulation(model, [sight(model, image, far) for image in (first, second)])
    assert outcome.points == {}
    assert "less than 1.5 degrees" in outcome.not_located["P"]
