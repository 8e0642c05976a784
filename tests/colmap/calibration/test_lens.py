"""Cameras that are free in part: how projections change with them, and how one lens shows turned pictures."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from wall_survey import SIZE, camera, pixels_of, survey, whole_block

from colmap_ihe.colmap.calibration.block import Block
from colmap_ihe.colmap.calibration.lens import FreeCamera, derivatives, fitted, tied, turned, with_params
from colmap_ihe.colmap.native import pycolmap

Float64 = NDArray[np.float64]
MODELS = {
    "SIMPLE_PINHOLE": (1000, 612, 440),
    "PINHOLE": (1000, 990, 612, 440),
    "SIMPLE_RADIAL": (1000, 612, 440, -0.1),
    "RADIAL": (1000, 612, 440, -0.1, 0.03),
    "OPENCV": (1000, 990, 612, 440, -0.1, 0.03, 0.002, -0.001),
    "FULL_OPENCV": (1000, 990, 612, 440, -0.1, 0.03, 0.002, -0.001, 0.01, 0.02, -0.01, 0.003),
    "FOV": (1000, 990, 612, 440, 0.6),
    "SIMPLE_RADIAL_FISHEYE": (716, 612, 440, 0.02),
    "RADIAL_FISHEYE": (716, 612, 440, 0.02, -0.01),
    "OPENCV_FISHEYE": (716, 710, 612, 440, 0.02, -0.01, 0.003, -0.001),
    "THIN_PRISM_FISHEYE": (716, 710, 612, 440, 0.02, -0.01, 0.002, -0.001, 0.003, 0.001, 0.002, -0.003),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        *(716, 710, 612, 440),
        *(0.02, -0.01, 0.003, 0.001, 0.002, 0.001, 0.002, -0.001, 0.002, -0.003, 0.001, 0.002),
    ),
    "SIMPLE_DIVISION": (1000, 612, 440, -0.05),
    "DIVISION": (1000, 990, 612, 440, -0.05),
    "SIMPLE_FISHEYE": (716, 612, 440),
    "FISHEYE": (716, 710, 612, 440),
    "EUCM": (900, 890, 612, 440, 0.5, 1.1),
}
RAYS = np.random.default_rng(1).uniform((-0.5, -0.4, 1), (0.5, 0.4, 1), (40, 3))


def of_one_image(points: Float64, pixels: Float64) -> Block:
    """Points of one camera, each seen once, in its own axes."""
    numbers = np.arange(len(points))
    none = np.zeros(len(points), np.intp)
    return Block(np.eye(3)[None], np.zeros((1, 3)), np.zeros(1, np.intp), points, none, numbers, pixels)


def every(lens: pycolmap.Camera) -> FreeCamera:
    return FreeCamera(lens, np.eye(len(lens.params)))


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_are_those_of_numeric_differences(model: str) -> None:
    lens = camera(model, MODELS[model])
    rays = RAYS * (3, 3, 1) if model.endswith("FISHEYE") else RAYS
    points = rays * np.linspace(2, 9, len(RAYS))[:, None]
    block, count = of_one_image(points, np.zeros((len(points), 2))), len(lens.params)
    terms = derivatives(block, [every(lens)], np.zeros(count))
    np.testing.assert_allclose(terms.residuals, pixels_of(lens, points))
    for index in range(count):
        step = np.zeros(count)
        step[index] = 1e-4 * max(1, abs(lens.params[index]))
        ahead, behind = (pixels_of(with_params(lens, lens.params + sign * step), points) for sign in (1, -1))
        numeric = (ahead - behind) / (2 * step[index])
        np.testing.assert_allclose(terms.by_free[:, :, index], numeric, rtol=1e-5, atol=1e-4)
    for axis in range(3):
        step = 1e-4 * np.eye(3)[axis]
        numeric = (pixels_of(lens, points + step) - pixels_of(lens, points - step)) / 2e-4
        np.testing.assert_allclose(terms.by_point[:, :, axis], numeric, rtol=1e-4, atol=1e-3)


def test_derivatives_of_a_pinhole_by_hand() -> None:
    points = RAYS * 3
    x, y, z = points.T
    terms = derivatives(
        of_one_image(points, np.zeros((len(points), 2))),
        [every(camera("SIMPLE_PINHOLE", (1000, 612, 440)))],
        np.zeros(3),
    )
    zero, one = np.zeros(len(points)), np.ones(len(points))
    by_point = np.stack([[1000 / z, zero, -1000 * x / z**2], [zero, 1000 / z, -1000 * y / z**2]])
    np.testing.assert_allclose(terms.by_point, np.moveaxis(by_point, 2, 0), rtol=1e-6, atol=1e-5)
    by_free = np.stack([[x / z, one, zero], [y / z, zero, one]])
    np.testing.assert_allclose(terms.by_free, np.moveaxis(by_free, 2, 0), atol=1e-9)


def test_focal_lengths_that_are_tied_move_alike_and_by_themselves_what_is_free() -> None:
    lens = camera("OPENCV", MODELS["OPENCV"])
    free = FreeCamera(lens, tied(lens, [2, 4]))
    assert free.at(np.array([10, -3, 0.01])).params == pytest.approx(
        np.add(MODELS["OPENCV"], (10, 10, -3, 0, 0.01, 0, 0, 0))
    )
    points = RAYS * 4
    block = of_one_image(points, np.zeros((len(points), 2)))
    single = derivatives(block, [every(lens)], np.zeros(8)).by_free
    both = derivatives(block, [free], np.zeros(3)).by_free
    np.testing.assert_allclose(both[:, :, 0], single[:, :, 0] + single[:, :, 1])
    np.testing.assert_allclose(both[:, :, 1:], single[:, :, [2, 4]])


def test_each_camera_of_several_has_its_own_derivatives() -> None:
    lenses = [camera(), camera("RADIAL_FISHEYE", MODELS["RADIAL_FISHEYE"], camera_id=2)]
    block, cameras = whole_block(survey(lenses, 4))
    free = [FreeCamera(one, np.zeros((len(one.params), 3))) for one in cameras]
    free[0].basis[0, 0], free[1].basis[0, 1], free[1].basis[3, 2] = 1, 1, 1
    terms = derivatives(block, free, np.zeros(3))
    assert np.abs(terms.residuals).max() < 1e-9
    second = block.cameras[block.image] == 1
    assert not terms.by_free[second][:, :, 0].any()
    assert not terms.by_free[~second][:, :, 1:].any()
    assert terms.by_free[second][:, :, 1:].any(axis=(0, 1)).all()


def test_what_has_no_projection_has_no_residual_and_warns_of_nothing() -> None:
    points = np.array([[0.1, 0.2, 2], [0.1, 0.2, -2], [0, 0, 0], [1, 0, 0], [np.nan, 0, 1], [1e200, 0, 1]])
    for model in ("SIMPLE_RADIAL", "OPENCV_FISHEYE"):
        lens = camera(model, MODELS[model])
        terms = derivatives(of_one_image(points, np.zeros((6, 2))), [every(lens)], np.zeros(len(lens.params)))
        finite = np.isfinite(terms.residuals[:5, 0])
        assert finite.tolist() == np.isfinite(terms.residuals[:5, 1]).tolist() == [True] + 4 * [False]
        assert np.isfinite(terms.by_point[0]).all()
        assert np.isfinite(terms.by_free[0]).all()


def test_a_projection_without_a_derivative_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lens that shows a point, but not what is a little farther out."""

    class Edge:
        params = np.array(MODELS["SIMPLE_PINHOLE"], np.float64)

        def __getattr__(self, name: str) -> object:
            return getattr(camera("SIMPLE_PINHOLE", MODELS["SIMPLE_PINHOLE"]), name)

        def img_from_cam(self, xyz: Float64) -> Float64:
            pixels = 1000 * xyz[:, :2] / xyz[:, 2:] + (612, 440)
            return np.where(xyz[:, :1] > 0.5, np.nan, pixels)

    monkeypatch.setattr(FreeCamera, "at", lambda *_: Edge())
    points = np.array([[0.1, 0.2, 1], [0.5, 0.2, 1]])
    free = every(camera("SIMPLE_PINHOLE", MODELS["SIMPLE_PINHOLE"]))
    terms = derivatives(of_one_image(points, np.zeros((2, 2))), [free], np.zeros(3))
    assert np.isnan(terms.residuals).tolist() == [[False, False], [True, True]]


@pytest.mark.parametrize("quarter", [1, 2, 3])
@pytest.mark.parametrize("model", MODELS)
def test_a_turned_picture_is_that_of_the_turned_lens(model: str, quarter: int) -> None:
    lens, (width, height) = camera(model, MODELS[model]), SIZE
    pixels = pixels_of(lens, RAYS)
    rays, size = RAYS, (width, height)
    for _ in range(quarter):  # clockwise: what was on the right is below
        pixels = np.column_stack([size[1] - pixels[:, 1], pixels[:, 0]])
        rays = np.column_stack([-rays[:, 1], rays[:, 0], rays[:, 2]])
        size = size[::-1]
    other = camera("SIMPLE_RADIAL", (1, 2, 3, 0), camera_id=7, size=size, exif=True)
    partner = turned(every(lens), other, quarter)
    assert (partner.camera.camera_id, partner.camera.width, partner.camera.height) == (7, *size)
    assert partner.camera.has_prior_focal_length
    np.testing.assert_allclose(pixels_of(partner.camera, rays), pixels, atol=1e-9)
    move = np.linspace(1e-3, 1e-2, len(lens.params))  # the same of both lenses, wherever it stands there
    direct = every(lens).at(move)
    again = pixels_of(turned(every(direct), other, quarter).camera, rays)
    np.testing.assert_allclose(pixels_of(partner.at(move), rays), again, atol=1e-9)


def test_derivatives_of_a_turned_partner_are_those_of_numeric_differences() -> None:
    lens = camera("OPENCV", MODELS["OPENCV"])
    points = RAYS * 3
    for quarter in (1, 3):
        partner = turned(FreeCamera(lens, tied(lens, [2, 3, 4, 6])), camera(size=(900, 1200)), quarter)
        terms = derivatives(of_one_image(points, np.zeros((len(points), 2))), [partner], np.zeros(5))
        for index, step in enumerate((1e-2, 1e-2, 1e-2, 1e-5, 1e-5)):
            change = np.zeros(5)
            change[index] = step
            ahead, behind = (pixels_of(partner.at(sign * change), points) for sign in (1, -1))
            np.testing.assert_allclose(
                terms.by_free[:, :, index], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-5
            )


def test_a_richer_model_shows_the_same_picture() -> None:
    lens = camera("SIMPLE_RADIAL", MODELS["SIMPLE_RADIAL"])
    for model, coefficients in (("RADIAL", 2), ("OPENCV", 4), ("FULL_OPENCV", 5)):
        richer = fitted(lens, model, coefficients)
        np.testing.assert_allclose(pixels_of(richer, RAYS), pixels_of(lens, RAYS), atol=1e-3)
    same = fitted(lens, "SIMPLE_RADIAL", 1)
    assert same.params.tolist() == lens.params.tolist()


def test_a_fisheye_shows_what_a_lens_with_little_distortion_shows() -> None:
    lens = camera("SIMPLE_RADIAL", (1400, 612, 440, -0.02))
    fisheye = fitted(lens, "OPENCV_FISHEYE", 4)
    across, down = np.meshgrid(np.linspace(0, SIZE[0], 9), np.linspace(0, SIZE[1], 9))
    pixels = np.stack([across, down], axis=-1).reshape(-1, 2)
    rays = np.column_stack([np.asarray(lens.cam_from_img(pixels)), np.ones(len(pixels))])
    np.testing.assert_allclose(pixels_of(fisheye, rays), pixels, atol=0.05)
    assert fisheye.params[2:4].tolist() == [612, 440]
