"""What is said of cameras before they are calibrated."""

from __future__ import annotations

from colmap_ihe.colmap.known_calibration import CalibrationUse
from colmap_ihe.pipeline.warnings.cameras import (
    calibration_warnings,
    focal_length_warnings,
    shared_camera_warnings,
)


def test_focal_lengths_that_are_guessed() -> None:
    assert focal_length_warnings(5, 5) == []
    (warning,) = focal_length_warnings(5, 3)
    assert warning.startswith("2 of 5 photographs do not say their focal length")
    assert "`cameras:`" in warning


def test_photographs_that_are_taken_as_by_one_camera() -> None:
    assert shared_camera_warnings([]) == []
    (one,) = shared_camera_warnings([12])
    assert one.startswith(
        "12 photographs whose EXIF lacks make, model or focal length were taken as by one camera"
    )
    assert "--set camera.mode=per_image" in one
    (two,) = shared_camera_warnings([3, 2])
    assert two.startswith("5 photographs")
    assert "as by 2 cameras, one for each size and what else EXIF says" in two


def test_what_a_calibration_was_not_good_for() -> None:
    by_grey = {"a.png": "a.jpg", "b/c.png": "b/c.dng"}
    assert calibration_warnings(CalibrationUse((1, 2)), by_grey) == []
    without, unused = calibration_warnings(
        CalibrationUse((1,), ("b/c.png",), ("Foo at 35 mm, 90x66", "Bar, 90x66")), by_grey
    )
    assert "for 1 photograph, which start as without it: b/c.dng" in without
    assert unused.endswith("took none of the photographs: Foo at 35 mm, 90x66; Bar, 90x66")
