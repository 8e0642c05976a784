"""What photographs of one camera share: one white balance for all colour twins."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from dngs import shoot

from colmap_ihe.evaluation.demo.exif import PhotoExif
from colmap_ihe.grey.convert import to_colour
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.recipes import with_recipes
from colmap_ihe.photographs.survey import Surveyed, survey
from colmap_ihe.project.options import DevelopOptions

AS_SHOT = {"a": (0.42, 1.0, 0.71), "b": (0.46, 1.0, 0.64), "c": (0.38, 1.0, 0.78)}


def prepared(folder: Path) -> list[Surveyed]:
    with ThreadPoolExecutor(2) as executor:
        surveyed, _ = survey(discover(folder).captures, executor, SILENT, strict=True)
        options = DevelopOptions()
        return with_recipes(surveyed, options, None, folder, executor, SILENT, strict=True).surveyed


def twin(photograph: Surveyed) -> list[int]:
    decoded = read_photograph(photograph.capture)
    assert decoded.srgb_from_camera is not None
    colour = to_colour(np.asarray(decoded.rgb, np.uint16), decoded.srgb_from_camera, 1.0)
    return [int(level) for level in colour[40, 40]]


def test_equal_sensor_values_are_one_colour_whatever_the_balance_of_the_shot(tmp_path: Path) -> None:
    mosaic = np.full((96, 128), 6000, np.uint16)
    for name, neutral in AS_SHOT.items():
        shoot(tmp_path / f"{name}.dng", mosaic, as_shot_neutral=neutral)
    surveyed = prepared(tmp_path)
    assert surveyed[0].capture.recipe.white_balance == pytest.approx((1 / 0.42, 1, 1 / 0.71), rel=1e-5)
    assert twin(surveyed[0]) == twin(surveyed[1]) == twin(surveyed[2])


def test_each_camera_has_a_balance_of_its_own(tmp_path: Path) -> None:
    mosaic = np.full((96, 128), 6000, np.uint16)
    for name, model in (("a", "One"), ("b", "Two"), ("c", "Two")):
        exif = PhotoExif(model=model)
        shoot(tmp_path / f"{name}.dng", mosaic, as_shot_neutral=AS_SHOT[name], exif=exif)
    first, second, third = (s.capture.recipe.white_balance for s in prepared(tmp_path))
    assert first == pytest.approx((1 / 0.42, 1, 1 / 0.71), rel=1e-5)
    assert (
        second == third == pytest.approx(((1 / 0.46 + 1 / 0.38) / 2, 1, (1 / 0.64 + 1 / 0.78) / 2), rel=1e-5)
    )
