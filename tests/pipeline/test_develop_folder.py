"""`develop`: RAW to linear TIFFs."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from colmap_ihe.cli import main
from colmap_ihe.errors import ProjectError
from colmap_ihe.photographs.exif.metadata import read_metadata
from colmap_ihe.photographs.raw.develop import develop
from colmap_ihe.pipeline.develop_folder import develop_folder


@pytest.fixture
def images(small_demo: Path, tmp_path: Path) -> Path:
    (tmp_path / "images" / "north").mkdir(parents=True)
    for name, place in (
        ("portico_01.dng", "a.dng"),
        ("portico_02.dng", "north/b.dng"),
        ("portico_03.jpg", "c.jpg"),
    ):
        (tmp_path / "images" / place).write_bytes((small_demo / "images" / name).read_bytes())
    return tmp_path / "images"


def test_raw_becomes_linear_tiffs_with_their_exif(images: Path, tmp_path: Path) -> None:
    names, steps, left_out = develop_folder(images, tmp_path / "out")
    assert names == {"a.dng": "a.tif", "north/b.dng": "north/b.tif"}
    assert not left_out
    assert list(steps.values()) == [["black level", "green equilibrium", "demosaicing (linear)"]]
    for source, tiff in names.items():
        truth = develop(images / source).linear_rgb
        np.testing.assert_array_equal(tifffile.imread(tmp_path / "out" / tiff), truth)
        read = cv2.imread(str(tmp_path / "out" / tiff), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
        assert read is not None
        np.testing.assert_array_equal(read[..., ::-1], truth)
        said, is_said = read_metadata(images / source, "raw"), read_metadata(tmp_path / "out" / tiff, "coded")
        for field in ("make", "model", "focal_mm", "focal_35mm", "exposure_s", "iso", "f_number", "lens"):
            assert getattr(said, field) == getattr(is_said, field), field
        with Image.open(tmp_path / "out" / tiff) as image:
            assert image.size == truth.shape[1::-1]


def test_what_is_up_to_date_is_not_written_again(images: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    develop_folder(images, out)
    before = {p: p.stat().st_mtime_ns for p in out.rglob("*.tif")}
    develop_folder(images, out)
    assert {p: p.stat().st_mtime_ns for p in out.rglob("*.tif")} == before
    (images / "a.dng").write_bytes((images / "north" / "b.dng").read_bytes())
    develop_folder(images, out)
    changed = {p.name for p in out.rglob("*.tif") if p.stat().st_mtime_ns != before[p]}
    assert changed == {"a.tif"}


def test_a_folder_without_raw_is_refused(images: Path, tmp_path: Path) -> None:
    (images / "a.dng").unlink()
    (images / "north" / "b.dng").unlink()
    with pytest.raises(ProjectError, match="none of its 1 photographs is a RAW file"):
        develop_folder(images, tmp_path / "out")


def test_the_command(images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["develop", str(images), str(tmp_path / "out"), "--json", "-q", "--demosaic", "vng"]
    assert main([*arguments, "--no-green-equilibrium"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found["linear"]) == {"a.dng", "north/b.dng"}
    assert list(found["steps"].values()) == [["black level", "demosaicing (vng)"]]
    assert main([*arguments, "--calibration", str(tmp_path / "nowhere")]) == 1
    assert "no such folder of calibration frames" in capsys.readouterr().err
