"""What a camera sees, against OpenCV's formulas of lenses and angles that are worked out here."""

from __future__ import annotations

import lenses
import numpy as np
import pytest
from lenses import OFF, SIZE, Lens, fisheye

from colmap_ihe.colmap.calibration.lens import fitted
from colmap_ihe.colmap.field_of_view import WIDEST_DEGREES, certain_box, pixels_of
from colmap_ihe.colmap.native import pycolmap

LENSES = [
    Lens("PINHOLE", (330, 333)),
    Lens("SIMPLE_RADIAL", (330, 330), (-0.1,)),
    Lens("RADIAL", (330, 330), (-0.1, 0.02)),
    Lens("OPENCV", (330, 333), (-0.12, 0.03, 0.002, -0.001)),
    Lens("FULL_OPENCV", (330, 333), (-0.12, 0.03, 0.002, -0.001, 0.01, 0.02, -0.01, 0.005)),
    fisheye(120, "SIMPLE_RADIAL_FISHEYE", (-0.02,)),
    fisheye(120, "RADIAL_FISHEYE", (-0.02, 0.004)),
    fisheye(120, "OPENCV_FISHEYE", (-0.02, 0.004, 0.001, -0.0005)),
]
PANORAMA = pycolmap.Camera.create_from_model_name(1, "EQUIRECTANGULAR", 1.0, 400, 200)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: str(lens.model))
def test_points_are_seen_where_they_are_and_nowhere_else(lens: Lens) -> None:
    draw = np.random.default_rng(0)
    points = draw.uniform(-1, 1, (2000, 3)) * (3, 2, 4)
    found = pixels_of(lens.camera(1), points)
    true = np.full((len(points), 2), np.nan)
    # cheirality, and the half of its field at which a model of these may still be trusted
    before = (points[:, 2] > 0) & (np.linalg.norm(points[:, :2], axis=1) < 2 * points[:, 2])
    true[before] = lens.pixels(points[before])
    with np.errstate(invalid="ignore"):
        true[~((true >= 0) & (true <= SIZE)).all(axis=1)] = np.nan
    assert 100 < np.isfinite(true[:, 0]).sum() < 1000
    assert np.allclose(found, true, atol=1e-6, equal_nan=True)
    assert certain_box(lens.camera(1)).tolist() == [0, 0, *SIZE]


def test_a_point_that_a_model_folds_back_is_not_seen() -> None:
    """x (1 - 0.3 x^2) is the same at 0.5 and at the root of 0.3 x^2 + 0.15 x = 0.925, 57 degrees from the axis."""
    camera = Lens("SIMPLE_RADIAL", (300, 300), (-0.3,), off=(0, 0)).camera(1)
    far = (np.sqrt(0.15**2 + 4 * 0.3 * 0.925) - 0.15) / (2 * 0.3)
    points = np.array([(0.5, 0, 1), (far, 0, 1)])
    assert np.asarray(camera.img_from_cam(points))[:, 0] == pytest.approx([298.75, 298.75])
    found = pixels_of(camera, points)
    assert found[0] == pytest.approx([298.75, 120])
    assert np.isnan(found[1]).all()


def test_the_part_of_a_picture_that_is_certain() -> None:
    reach = np.radians(WIDEST_DEGREES)
    lens = fisheye(200)
    middle = np.array(SIZE) / 2 + OFF
    left, _, right, bottom = certain_box(lens.camera(1))
    assert (left, bottom) != (0, SIZE[1])
    farthest = np.linalg.norm(np.array([left, bottom]) - middle) / lens.focal[0]
    assert 0.97 * reach < farthest < reach
    assert right == SIZE[0] or right - middle[0] == pytest.approx(middle[0] - left)
    # A model that reaches no farther than 0.703 from its middle says nothing of the corners, 0.75 away.
    turning = Lens("SIMPLE_RADIAL", (266, 266), (-0.3,), off=(0, 0))
    box = certain_box(turning.camera(1))
    corner = np.hypot(*(box[2:] - box[:2])) / 2 / 266
    assert 0.66 < corner < 0.703
    assert np.isnan(certain_box(Lens("SIMPLE_RADIAL", (1, 1), (-0.3,)).camera(1))).all()
    assert certain_box(PANORAMA).tolist() == [0, 0, 400, 200]


def test_a_panorama_sees_all_around() -> None:
    points = np.array([(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 1)], float)
    assert pixels_of(PANORAMA, points)[:, 1] == pytest.approx([100, 100, 100, 150])
    assert pixels_of(PANORAMA, points)[[0, 2], 0] == pytest.approx([200, 300])


def test_rays_of_photographs_are_those_of_their_pixels() -> None:
    """The scene that other tests trust: OpenCV there and back again."""
    for lens in LENSES:
        pixels = lenses.centres(SIZE)[::97]
        assert lens.pixels(lens.rays(pixels)) == pytest.approx(pixels, abs=1e-6)


@pytest.mark.parametrize("degrees", [120, 180, 200])
def test_a_fisheye_is_the_same_in_a_richer_model(degrees: float) -> None:
    """Also one with pixels at 90 degrees and more, whose rays COLMAP has wrong: by them it was up to 46 pixels off."""
    lens = fisheye(degrees, "SIMPLE_RADIAL_FISHEYE", (0.002,))
    camera = lens.camera(1)
    draw = np.random.default_rng(0)
    angle, around = np.radians(draw.uniform(0, 75, 500)), draw.uniform(0, 2 * np.pi, 500)
    rays = np.stack([np.tan(angle) * np.cos(around), np.tan(angle) * np.sin(around), np.ones(500)], axis=1)
    richer = np.asarray(fitted(camera, "OPENCV_FISHEYE", 4).img_from_cam(rays))
    assert np.abs(richer - lens.pixels(rays)).max() < 0.01
