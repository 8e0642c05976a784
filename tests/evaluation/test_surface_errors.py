"""Errors of surfaces whose distance is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from surface_errors import moved, points_on, surface_errors, true_points

from colmap_ihe.evaluation.truth import Similarity, TrueImage

SQUARE = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]], np.float32)


def test_half_a_surface_at_a_distance() -> None:
    true = points_on(SQUARE, 20_000)
    half = points_on(SQUARE * np.array([0.5, 1, 1], np.float32) + np.array([0, 0, 0.05], np.float32), 20_000)
    errors = surface_errors(half, true)
    assert errors.shares_percent(0.049) == (0.0, 0.0)
    accuracy, completeness = errors.shares_percent(0.07)
    assert accuracy == 100
    assert 52 < completeness < 58
    with pytest.raises(ValueError, match=r"true_points\.shape"):
        surface_errors(half, true[:0])


def test_points_are_equally_dense() -> None:
    large = np.concatenate((SQUARE, 3 * SQUARE + 5))
    points = points_on(large, 10_000)
    assert (points[:, 2] < 1).mean() == pytest.approx(0.1, abs=0.02)


def test_true_points_are_where_the_camera_saw_them(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 6), 65535 // 2, np.uint16)).save(tmp_path / "depth.png")
    K = np.array([[10.0, 0, 3], [0, 10, 2], [0, 0, 1]])
    pose = np.column_stack((np.eye(3), [0, 0, 1.0]))
    points = true_points(TrueImage(6, 4, K, pose, tmp_path / "depth.png"))
    assert len(points) == 24
    assert np.allclose(points[:, 2], 1.0, atol=1e-3)
    assert np.allclose(points[0, :2], [-0.5, -0.3], atol=1e-3)
    turned = moved(points, Similarity(2.0, np.eye(3), np.array([1.0, 0, 0])))
    assert np.allclose(turned, 2 * points + [1, 0, 0], atol=1e-6)
