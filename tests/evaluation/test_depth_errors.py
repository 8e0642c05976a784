"""Depth errors of depth maps that are wrong by known amounts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from colmap_ihe.evaluation.depth_errors import depth_errors, pooled
from colmap_ihe.evaluation.truth import F32, F64, TrueImage

WIDTH, HEIGHT = 240, 160
K = np.array(((200.0, 0, 120), (0, 200, 80), (0, 0, 1)))


def slanted(calibration: F64, width: int, height: int) -> F32:
    """Depth of the plane z = 5 + 0.8 x + 0.3 y in the camera's frame, which needs no picture."""
    x = (np.arange(width) + 0.5 - calibration[0, 2]) / calibration[0, 0]
    y = (np.arange(height) + 0.5 - calibration[1, 2]) / calibration[1, 1]
    return np.asarray(5 / (1 - 0.8 * x[None, :] - 0.3 * y[:, None]), np.float32)


@pytest.fixture
def image(tmp_path: Path) -> TrueImage:
    """The plane, with nothing (sky) in the upper quarter."""
    depth = slanted(K, WIDTH, HEIGHT)
    nearest = float(depth.min())
    code = np.rint(65535 * nearest / depth).astype(np.uint16)
    code[: HEIGHT // 4] = 0
    Image.fromarray(code).save(tmp_path / "a.depth.png")
    return TrueImage(WIDTH, HEIGHT, K, np.eye(3, 4), tmp_path / "a.depth.png", nearest)


def test_true_depth_is_stored_far_more_finely_than_it_is_judged(image: TrueImage) -> None:
    depth = image.depth_m()
    assert not depth[: HEIGHT // 4].any()
    expected = slanted(K, WIDTH, HEIGHT)[HEIGHT // 4 :]
    assert np.abs(depth[HEIGHT // 4 :] / expected - 1).max() < 1e-4


def test_right_depth_has_no_error_and_full_coverage(image: TrueImage) -> None:
    errors = depth_errors(slanted(K, WIDTH, HEIGHT) / np.float32(4), K, image, metres_per_unit=4.0)
    assert errors.median_percent < 0.005
    assert errors.all.right_percent == 100
    assert errors.all.seeing == WIDTH * HEIGHT * 3 // 4


def test_a_known_error_is_found(image: TrueImage) -> None:
    errors = depth_errors(slanted(K, WIDTH, HEIGHT) * np.float32(1.01), K, image, 1.0)
    assert errors.median_percent == pytest.approx(1, abs=0.01)
    assert errors.all.right_percent == 100
    errors = depth_errors(slanted(K, WIDTH, HEIGHT) * np.float32(1.1), K, image, 1.0)
    assert (errors.all.right, errors.all.wrong_percent) == (0, 100)


def test_depth_in_the_sky_is_wrong(image: TrueImage) -> None:
    depth = slanted(K, WIDTH, HEIGHT)
    errors = depth_errors(depth, K, image, 1.0)
    assert errors.all.right == WIDTH * HEIGHT * 3 // 4
    assert errors.all.wrong == WIDTH * (HEIGHT // 4 - 1)
    depth[: HEIGHT // 4] = 0
    assert depth_errors(depth, K, image, 1.0).all.wrong_percent == 0


def test_pixels_without_depth_lower_the_coverage_only(image: TrueImage) -> None:
    depth = slanted(K, WIDTH, HEIGHT)
    depth[:, :60] = 0
    depth[:, 60:120] = np.nan
    errors = depth_errors(depth, K, image, 1.0)
    assert errors.all.right_percent == pytest.approx(50)
    assert errors.median_percent < 0.005


@pytest.mark.parametrize("scale", [0.5, 1.7])
def test_another_camera_at_the_same_place_is_matched_by_rays(image: TrueImage, scale: float) -> None:
    width, height = int(WIDTH * scale), int(HEIGHT * scale)
    other = np.array(((190 * scale, 0, 0.52 * width), (0, 205 * scale, 0.49 * height), (0, 0, 1)))
    errors = depth_errors(slanted(other, width, height), other, image, 1.0)
    # Half a true pixel of this plane is up to 0.4 % of depth: the nearest pixel is not the same ray.
    assert errors.median_percent < 0.25
    assert errors.all.right_percent == 100
    unscaled = depth_errors(slanted(other, width, height), K, image, 1.0)
    assert unscaled.median_percent > 1


def test_edges_have_figures_of_their_own(tmp_path: Path) -> None:
    """Depth 3 and, from column 40 on, 6.55: the foreground is two pixels too wide, and one is a depth between both."""
    code = np.full((80, 80), 65535, np.uint16)
    code[:, 40:] = 30000
    Image.fromarray(code).save(tmp_path / "a.png")
    image = TrueImage(80, 80, K, np.eye(3, 4), tmp_path / "a.png", 3.0)
    estimated = image.depth_m()
    estimated[:, 40:42] = 3.0  # the first lies beside the edge, where either depth is right
    estimated[:, 42] = 5.0
    errors = depth_errors(estimated, K, image, 1.0)
    assert errors.relative_percent.size == 80 * 78
    assert errors.all.right_percent == pytest.approx(100 * 78 / 80)
    assert errors.near_edges.seeing == 80 * 10
    assert errors.near_edges.right_percent == pytest.approx(80)
    assert errors.near_edges.wrong_percent == pytest.approx(20)


def test_images_are_pooled_by_pixels(image: TrueImage) -> None:
    right = depth_errors(slanted(K, WIDTH, HEIGHT), K, image, 1.0)
    nothing = depth_errors(np.zeros((HEIGHT, WIDTH), np.float32), K, image, 1.0)
    both = pooled([right, nothing])
    assert both.all.right_percent == pytest.approx(50)
    assert both.median_percent == right.median_percent
    assert np.isnan(nothing.median_percent)


def test_an_undistorted_camera_off_the_middle_is_compared_ray_by_ray(image: TrueImage) -> None:
    """Of another size, with another focal length across than down, and its principal point 3 % off, both ways."""
    calibration = np.array(((250.0, 0, 150 - 9), (0, 240, 100 + 9), (0, 0, 1)))
    errors = depth_errors(slanted(calibration, 300, 200), calibration, image, 1.0)
    assert errors.median_percent < 0.3  # half a true pixel
    assert errors.all.right_percent > 99.9
    middle = np.array(((250.0, 0, 150), (0, 240, 100), (0, 0, 1)))
    assert depth_errors(slanted(calibration, 300, 200), middle, image, 1.0).median_percent > 1.5
