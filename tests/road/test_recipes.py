"""Calibration frames and options of development in a project: what they change, what runs again, what is noted."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from same_results import pixels_of
from small_demo import Make, MakeOptions

from colmap_ihe.pipeline.convert_folder import convert_folder
from colmap_ihe.pipeline.develop_folder import develop_folder
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.options import DevelopOptions


@pytest.fixture
def project(new_project: Make) -> Path:
    return new_project(3, (".dng",))


def grey_of(project: Path) -> Any:
    return pixels_of(project / "workspace/images/portico_01.png")


@pytest.mark.slow
def test_frames_of_a_project_change_its_grey_images(project: Path, quick_options: MakeOptions) -> None:
    options = quick_options()
    reconstruct(project, options, until="convert")
    before = grey_of(project)
    record = (project / "records" / "captures.json").read_text()
    assert '"black level"' in record
    frames = project / "calibration" / "darks"
    frames.mkdir(parents=True)
    # stands in for a dark frame: far too bright
    shutil.copy(project / "images" / "portico_02.dng", frames / "a.dng")
    states = {s.name: s for s in status(project, options)}
    assert states["captures"].state == "stale"
    done = reconstruct(project, options, until="convert")
    assert done.stages_run == ("captures", "fit", "convert")
    assert '"dark frame"' in (project / "records" / "captures.json").read_text()
    assert np.abs(grey_of(project).astype(int) - before).mean() > 5
    masters = set((project / "records" / "calibration").iterdir())
    assert masters
    assert reconstruct(project, options, until="convert").stages_run == ()
    moved = project.rename(project.with_name("moved"))
    assert reconstruct(moved, options, until="convert").stages_run == ()
    shutil.rmtree(moved / "calibration")
    reconstruct(moved, options, until="captures")
    assert not list((moved / "records" / "calibration").iterdir())


@pytest.mark.slow
def test_a_stage_that_goes_on_later_uses_the_same_recipes(project: Path, quick_options: MakeOptions) -> None:
    (project / "calibration").mkdir()
    (project / "calibration" / "bad-pixels.txt").write_text("100 100\n")
    options = quick_options("develop.demosaic=vng", "develop.balance=true")
    reconstruct(project, options, until="convert")
    at_once = grey_of(project)
    shutil.rmtree(project / "workspace" / "images")
    assert reconstruct(project, options, until="convert").stages_run == ("convert",)
    np.testing.assert_array_equal(grey_of(project), at_once)
    shutil.rmtree(project / "records" / "calibration")
    assert "captures" in reconstruct(project, options, until="convert").stages_run
    np.testing.assert_array_equal(grey_of(project), at_once)


def test_every_option_of_development_makes_the_captures_stale(
    project: Path, quick_options: MakeOptions
) -> None:
    reconstruct(project, quick_options(), until="captures")
    changes = {"demosaic": "ahd", "green_equilibrium": "false", "find_bad_pixels": "true"}
    changes |= {"exposure": "normalise", "balance": "true", "denoise": "1"}
    assert set(changes) == set(DevelopOptions.model_fields)
    for name, value in changes.items():
        states = {s.name: s.state for s in status(project, quick_options(f"develop.{name}={value}"))}
        assert states["captures"] == "stale", name


def test_convert_takes_frames_and_options(project: Path, tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "bad-pixels.txt").write_text("100 100\n")
    out = tmp_path / "out"
    written = []
    for frames in (None, tmp_path / "frames", tmp_path / "frames"):
        convert_folder(project / "images", out, calibration=frames)
        written.append({p.name: p.stat().st_mtime_ns for p in out.glob("*.png")})
    plain, first, second = written
    assert all(first[name] != plain[name] for name in first) and second == first


def test_exposures_that_exif_tells_are_brought_level(project: Path, tmp_path: Path) -> None:
    """The same shot, once as it is and once with an EXIF that says it got four times the light."""
    images = tmp_path / "pair"
    images.mkdir()
    source = (project / "images" / "portico_01.dng").read_bytes()
    (images / "a.dng").write_bytes(source)
    iso = b"\x27\x88\x03\x00\x01\x00\x00\x00"  # ISOSpeedRatings, one SHORT
    assert source.count(iso + b"\x64\x00") == 1
    (images / "b.dng").write_bytes(source.replace(iso + b"\x64\x00", iso + b"\x90\x01"))  # 100 to 400
    develop_folder(images, tmp_path / "out", options=DevelopOptions(exposure="normalise"))
    a, b = (tifffile.imread(tmp_path / "out" / f"{n}.tif").astype(float) for n in "ab")
    np.testing.assert_allclose(a / 4, b, atol=1)
