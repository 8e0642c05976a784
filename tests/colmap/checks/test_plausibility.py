"""Cameras of a model as warnings are told of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from doubled import doubled_model

from colmap_ihe.colmap.checks.plausibility import SolvedCamera, cameras_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.part_databases import write_images


@pytest.mark.parametrize(
    ("model", "params", "focal"),
    [
        ("OPENCV_FISHEYE", [104.0, 100.0, 55.0, 38.0, 0.1, 0, 0, 0], 102.0),
        ("SIMPLE_RADIAL", [110.0, 55.0, 38.0, -0.1], 110.0),
        ("EQUIRECTANGULAR", [100.0, 80.0], None),
    ],
)
def test_solved_and_given_focal_lengths(
    tmp_path: Path, model: str, params: list[float], focal: float | None
) -> None:
    """A panorama has none, and COLMAP ends the process that asks for it."""
    solved = doubled_model([1, 2, 3, 4])
    camera = solved.cameras[1]
    given = pycolmap.Camera.create_from_model_name(1, model, 100.0, 100, 80)
    given.has_prior_focal_length = True
    numbers = range(1, 5)
    write_images(tmp_path / "database.db", dict.fromkeys(numbers, given), {n: f"{n}.png" for n in numbers})
    camera.model, camera.params = pycolmap.CameraModelId.__members__[model], params
    solved.write(tmp_path)
    found = cameras_of(tmp_path, tmp_path / "database.db")
    names = ("1.png", "2.png", "3.png", "4.png")
    aspect = 1.04 if model == "OPENCV_FISHEYE" else 1.0
    assert found == ([] if focal is None else [SolvedCamera(names, 100.0, focal, aspect)])
