"""Linear photographs of several cameras, and TIFFs that look linear, are told."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import tifffile
from dngs import shoot

from colmap_ihe.evaluation.demo.exif import PhotoExif
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.linear_tiff import encode_linear_tiff
from colmap_ihe.photographs.survey import survey
from colmap_ihe.pipeline.warnings.linear import linear_warnings


def warnings_of(folder: Path) -> list[str]:
    with ThreadPoolExecutor(2) as executor:
        return linear_warnings(survey(discover(folder).captures, executor, SILENT, strict=True)[0])


def test_raw_of_two_makes_is_told_with_counts(tmp_path: Path) -> None:
    mosaic = np.full((96, 128), 6000, np.uint16)
    for name, make in (("a", "Nikon"), ("b", "Canon"), ("c", "Canon")):
        shoot(tmp_path / f"{name}.dng", mosaic, exif=PhotoExif(make=make, model="One"))
    [warning] = warnings_of(tmp_path)
    assert "different cameras (2 by Canon One, 1 by Nikon One)" in warning
    (tmp_path / "a.dng").unlink()
    assert warnings_of(tmp_path) == []


@pytest.mark.parametrize(("gamma", "is_told"), [(1.0, True), (2.2, False)])
def test_tiffs_that_look_linear_are_told(tmp_path: Path, gamma: float, is_told: bool) -> None:
    """A log-normal scene, as photographs are: its median at a fifth of its brightest light."""
    rng = np.random.default_rng(3)
    light = np.clip(np.exp(rng.normal(np.log(0.2), 0.7, (120, 160, 1))), 0, 1)
    pixels = np.rint(65535 * light ** (1 / gamma)).astype(np.uint16).repeat(3, axis=2)
    for name in "abc":
        tifffile.imwrite(tmp_path / f"{name}.tif", pixels, photometric="rgb")
    assert [w.partition(":")[0] for w in warnings_of(tmp_path)] == (
        ["3 TIFF files look linear, as a.tif"] if is_told else []
    )
    for name in "abc":
        (tmp_path / f"{name}.tif").write_bytes(encode_linear_tiff(pixels, b""))
    assert warnings_of(tmp_path) == []  # they are read as linear
