"""A calibration file gives the same numbers back, and what is none is refused with what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from plane import VIEWS, make_project

from colmap_ihe.colmap.calibration_file import (
    CalibratedCamera,
    cameras_of,
    in_words,
    read_calibration,
    write_calibration,
)
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import CalibrationFileError
from colmap_ihe.photographs.camera_identity import CameraIdentity

CANON: dict[str, Any] = {
    "make": "Canon",
    "model": "Canon EOS 5D",
    "focal_length_mm": 35.0,
    "focal_length_35mm": 0.0,
    "width": 5616,
    "height": 3744,
    "camera_model": "OPENCV",
    "params": [5512.123456789012, 5513.1, 2801.7, 1877.3, -0.1, 1e-7, 1 / 3, -2e-5],
    "standard_deviations": [0.4, 0.5, 1.1, 1.2, 1e-5, 3e-5, 0.0, 0.0],
    "photographs": 24,
}
SCAN = {
    **CANON, "make": "", "model": "", "focal_length_mm": 0.0, "camera_model": "SIMPLE_RADIAL",
    "params": [600.0, 320.0, 240.0, 0.01], "standard_deviations": None, "width": 640, "height": 480,
}  # fmt: skip


def written(folder: Path, *cameras: dict[str, Any], **more: Any) -> Path:
    file = folder / "calibration.yaml"
    file.write_text(yaml.safe_dump({"colmap_ihe_calibration": 1, "cameras": list(cameras)} | more))
    return file


def test_the_same_numbers_come_back(tmp_path: Path) -> None:
    cameras = [CalibratedCamera(**CANON), CalibratedCamera(**SCAN)]
    write_calibration(tmp_path / "calibration.yaml", cameras)
    assert read_calibration(tmp_path / "calibration.yaml") == cameras
    values = yaml.safe_load((tmp_path / "calibration.yaml").read_text())
    assert values["colmap_ihe_calibration"] == 1
    assert list(values["cameras"][0].items()) == list(CANON.items())


def test_a_camera_is_that_of_photographs_by_exif_and_size(tmp_path: Path) -> None:
    camera, scan = read_calibration(written(tmp_path, CANON, SCAN))
    assert camera.identity == CameraIdentity("Canon", "Canon EOS 5D", 35, 0, 5616, 3744)
    assert in_words(camera.identity) == "Canon EOS 5D at 35 mm, 5616x3744"
    assert in_words(scan.identity) == "no make and model, 640x480"
    without_equivalent = {key: value for key, value in CANON.items() if key != "focal_length_35mm"}
    assert read_calibration(written(tmp_path, without_equivalent)) == [camera]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"params": [1.0, 2.0]}, r"cameras\.0; params has 2 numbers, OPENCV has 8 \(fx, fy, cx, cy, k1"),
        ({"standard_deviations": [1.0]}, "standard_deviations has 1 numbers, OPENCV has 8"),
        ({"camera_model": "FISHEYES"}, "camera_model is 'FISHEYES', expected one of SIMPLE_PINHOLE, PINHOLE"),
        ({"params": [0.0, *CANON["params"][1:]]}, "expected a focal length above 0"),
        ({"params": [float("nan"), *CANON["params"][1:]]}, r"cameras\.0\.params\.0 is nan; input should be a finite"),
        ({"width": "5616"}, r"cameras\.0\.width is '5616'; input should be a valid integer"),
        ({"height": 0}, r"cameras\.0\.height is 0; input should be greater than or equal to 1"),
        ({"focal_length_mm": -1.0}, r"cameras\.0\.focal_length_mm is -1\.0"),
        ({"lens": "35mm"}, r"cameras\.0\.lens is '35mm'; extra inputs are not permitted"),
        ({"make": "a\0b"}, "hold"),
    ],
)  # fmt: skip
def test_what_is_no_camera_is_refused_with_its_place(
    tmp_path: Path, change: dict[str, Any], words: str
) -> None:
    file = written(tmp_path, CANON | change)
    with pytest.raises(CalibrationFileError, match=words) as caught:
        read_calibration(file)
    assert str(file) in str(caught.value)
    assert "report/calibration.yaml" in caught.value.hint


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not a calibration file, it holds None"),
        ("weights: [0.2, 0.7, 0.1]", "colmap_ihe_calibration; field required"),
        ("{colmap_ihe_calibration: 2, cameras: []}", "colmap_ihe_calibration is 2; input should be 1"),
        ("{colmap_ihe_calibration: 1, cameras: []}", "cameras is .*at least 1 item"),
        ("{", "cannot be read"),
        (None, "cannot be read"),
    ],
)
def test_what_is_no_calibration_file_is_refused(tmp_path: Path, text: str | None, words: str) -> None:
    file = tmp_path / "calibration.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(CalibrationFileError, match=words):
        read_calibration(file)


def test_two_calibrations_of_one_camera_are_refused(tmp_path: Path) -> None:
    file = written(tmp_path, SCAN, CANON, {**CANON, "photographs": 3})
    with pytest.raises(
        CalibrationFileError, match=r"cameras 2 and 3 are both for .* by Canon EOS 5D at 35"
    ) as caught:
        read_calibration(file)
    assert caught.value.hint == "keep one of them"
    assert len(read_calibration(written(tmp_path, CANON, {**CANON, "width": 5000}))) == 2


def test_the_cameras_of_a_model(tmp_path: Path) -> None:
    """Of plane.py: five views by one camera, of which one says nothing of it and one could not be read."""
    make_project(tmp_path)
    model = pycolmap.Reconstruction(tmp_path / "sparse")
    canon = CameraIdentity("Canon", "Canon EOS 5D", 35, 0, 320, 240)
    identities = dict.fromkeys(VIEWS, canon) | {"e.png": CameraIdentity("", "", 0, 0, 320, 240)}
    del identities["nef/a.png"]
    scan, camera = cameras_of(model, identities, {1: [0.5, 0.5, 0, 0]})
    assert (camera.identity, camera.photographs) == (canon, 3)
    assert (scan.identity, scan.photographs) == (identities["e.png"], 1)
    assert (camera.camera_model, camera.params) == ("PINHOLE", [340, 340, 160, 120])
    assert camera.standard_deviations == [0.5, 0.5, 0, 0]
    assert cameras_of(model, identities, {})[0].standard_deviations is None
    write_calibration(tmp_path / "calibration.yaml", [scan, camera])
    assert read_calibration(tmp_path / "calibration.yaml") == [scan, camera]
