"""Depth of the painted panels is judged where they are seen, without their borders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.evaluation.demo.paintings import PANELS, painted_depth_percent, panel_pixels
from colmap_ihe.evaluation.truth import read_truth


def test_true_depth_is_right_and_depth_off_by_a_percent_is_not(small_demo: Path) -> None:
    images = read_truth(small_demo / "truth").images
    image = images["portico_03"]
    seen = {name: int(pixels.sum()) for name, pixels in panel_pixels(image).items()}
    assert seen.keys() == PANELS.keys()
    assert seen["rosette"] > 300
    depth, k = image.depth_m(), image.calibration
    assert painted_depth_percent([(depth / np.float32(2), k, image)], 2.0)["rosette"] == 100
    assert painted_depth_percent([(depth * np.float32(1.01), k, image)], 1.0)["rosette"] == 0
    half = depth.copy()
    rows = np.nonzero(panel_pixels(image)["rosette"])[0]
    half[: int(np.median(rows)) + 1] = 0
    assert painted_depth_percent([(half, k, image)], 1.0)["rosette"] == pytest.approx(50, abs=6)
