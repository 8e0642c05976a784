"""Errors at edges of depth maps that are wrong there by known amounts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from edge_errors import edge_errors, pooled_edges
from PIL import Image

from colmap_ihe.evaluation.truth import F32, TrueImage

K = np.array(((200.0, 0, 40), (0, 200, 40), (0, 0, 1)))
TOWARDS = np.array((0, 0, -1), np.float32)


@pytest.fixture
def image(tmp_path: Path) -> TrueImage:
    """Depth 3 and, from column 40 on, 6.55, in 80 x 80 pixels."""
    code = np.full((80, 80), 65535, np.uint16)
    code[:, 40:] = 30000
    Image.fromarray(code).save(tmp_path / "a.png")
    return TrueImage(80, 80, K, np.eye(3, 4), tmp_path / "a.png", 3.0)


def _normals() -> F32:
    return np.tile(TOWARDS, (80, 80, 1))


def test_the_far_side_reaches_four_pixels_and_counts_fattened_foreground(image: TrueImage) -> None:
    depth = image.depth_m()
    depth[:, 40:42] = 3.0  # the first touches the edge, where either depth is right
    depth[:, 42] *= 0.99
    depth[:40, 43] = 0
    errors = edge_errors(depth, _normals(), K, image, 1.0)
    assert errors.far_side_pixels == 80 * 4
    assert errors.far_side_covered_percent == pytest.approx(100 * 280 / 320)
    assert errors.far_side_wrong_percent == pytest.approx(100 * 80 / 280)
    assert np.sort(np.unique(np.round(errors.far_side_percent, 2))) == pytest.approx(
        [-54.22, -1, 0], abs=0.05
    )
    assert errors.far_side_median_percent == pytest.approx(-0.5, abs=0.51)


def test_a_right_map_has_no_error_in_any_unit(image: TrueImage) -> None:
    errors = edge_errors(image.depth_m() / np.float32(4), _normals(), K, image, metres_per_unit=4.0)
    assert errors.far_side_covered_percent == 100
    assert errors.far_side_wrong_percent == 0
    assert errors.far_side_median_percent == pytest.approx(0, abs=0.001)
    assert errors.normals_near_wrong_percent == 0
    assert errors.normals_elsewhere_median_deg < 0.1


def test_normals_are_judged_near_edges_and_elsewhere(image: TrueImage) -> None:
    """Columns 39 and 40 touch the edge: 34 to 37 and 42 to 45, and one more either way, are near it."""
    turned, slightly = (np.array((np.sin(a), 0, -np.cos(a)), np.float32) for a in np.radians((12.0, 3.0)))
    normals = _normals()
    normals[:, :30] = slightly
    normals[:, 36] = turned
    normals[:, 38:42] = turned  # not judged
    errors = edge_errors(image.depth_m(), normals, K, image, 1.0)
    assert errors.normals_near_deg.size == 80 * 10
    assert errors.normals_near_wrong_percent == pytest.approx(10)
    assert errors.normals_elsewhere_deg.max() == pytest.approx(3, abs=0.2)
    normals[:, 43] = 0  # none
    assert edge_errors(image.depth_m(), normals, K, image, 1.0).normals_near_deg.size == 80 * 9


def test_images_are_pooled_by_pixels(image: TrueImage) -> None:
    right = edge_errors(image.depth_m(), _normals(), K, image, 1.0)
    nothing = edge_errors(np.zeros((80, 80), np.float32), _normals(), K, image, 1.0)
    both = pooled_edges([right, nothing])
    assert both.far_side_covered_percent == 50
    assert both.far_side_wrong_percent == 0
    assert both.normals_near_deg.size == right.normals_near_deg.size
    assert np.isnan(nothing.far_side_median_percent)
    assert np.isnan(nothing.normals_near_wrong_percent)
    assert np.isnan(pooled_edges([]).far_side_covered_percent)
