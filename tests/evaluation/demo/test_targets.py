"""The demo's targets: what is painted, where, and what the survey says of them."""

from __future__ import annotations

import csv
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from colmap_ihe.evaluation.demo import targets
from colmap_ihe.evaluation.demo.grid import Grid
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.evaluation.demo.scene import ISOLUMINANT_PANELS
from colmap_ihe.evaluation.demo.shapes import Rect
from colmap_ihe.evaluation.truth import read_truth
from colmap_ihe.survey.targets import find_targets

TRUE = {f"T{target.number}": target.centre for target in targets.TARGETS}


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


def test_a_board_shows_its_target_in_the_middle() -> None:
    for patch, target in zip(targets.target_patches(), targets.TARGETS, strict=True):
        grid = Grid(*patch.shape.size_m, 0.0075, 0)
        albedo = patch.material(grid)
        grey = np.asarray(albedo[..., 1] * 255, np.uint8)
        (found,) = find_targets(np.pad(grey, 5, constant_values=110))
        assert found.name == f"T{target.number}"
        np.testing.assert_allclose(np.array(found.centre_px) - 5, np.array(grid.shape[::-1]) / 2, atol=0.02)
        assert found.side_px * 0.0075 == pytest.approx(targets.SIDE_M, rel=0.005)
        np.testing.assert_allclose(patch.shape.box.mean(axis=0), target.centre, atol=1e-9)


def test_boards_overlap_neither_each_other_nor_the_painted_panels() -> None:
    boards = [patch.shape for patch in targets.target_patches()]
    shapes = [shape for shape in (*boards, *ISOLUMINANT_PANELS) if isinstance(shape, Rect)]
    assert len(shapes) == len(targets.TARGETS) + 3
    for one, other in combinations(shapes, 2):
        apart = [one.low[k] >= other.high[k] or other.low[k] >= one.high[k] for k in (0, 1)]
        assert any(apart) or abs(one.at - other.at) > 1


def test_the_survey_has_control_check_points_and_scale_bars_near_the_truth() -> None:
    files = targets.control_files(0)
    assert files == targets.control_files(0) != targets.control_files(1)
    points, bars = rows_of(files["points.csv"]), rows_of(files["scalebars.csv"])
    assert [point["role"] for point in points] == ["control"] * 5 + ["check"] * 5
    off = np.array([[float(point[k]) for k in "xyz"] - TRUE[point["name"]] for point in points])
    assert 0.0005 < np.sqrt((off**2).mean()) < 0.0015
    assert {float(point["accuracy_m"]) for point in points} == {0.001}
    assert {bar[end] for bar in bars for end in "ab"}.isdisjoint(point["name"] for point in points)
    lengths = [float(np.linalg.norm(TRUE[bar["a"]] - TRUE[bar["b"]])) for bar in bars]
    np.testing.assert_allclose([float(bar["length_m"]) for bar in bars], lengths, atol=0.002)


def test_a_demo_too_small_to_read_targets_has_none(small_demo: Path) -> None:
    assert not (small_demo / "control").exists()


@pytest.mark.slow
def test_photographs_show_targets_where_the_truth_has_them(tmp_path: Path) -> None:
    render_demo(tmp_path, views=2, size=(1504, 1000))
    assert sorted(file.name for file in (tmp_path / "control").iterdir()) == ["points.csv", "scalebars.csv"]
    off = []
    for stem, image in read_truth(tmp_path / "truth").images.items():
        grey = np.asarray(Image.open(tmp_path / f"images/{stem}.jpg").convert("L"))
        for found in find_targets(grey):
            in_camera = image.cam_from_world @ np.append(TRUE[found.name], 1)
            pixel = image.calibration @ in_camera
            off.append(np.subtract(found.centre_px, pixel[:2] / pixel[2]))
    assert len(off) > 8
    assert np.sqrt(np.mean(np.square(off))) < 0.1
