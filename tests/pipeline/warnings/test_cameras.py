"""What is said of cameras before they are calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from colmap_ihe.colmap.calibration.held_out import HeldOut
from colmap_ihe.colmap.known_calibration import CalibrationUse
from colmap_ihe.pipeline.warnings.cameras import (
    apart_warnings,
    calibration_warnings,
    doubtful_calibrations,
    focal_length_warnings,
    refused_calibrations,
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


def test_photographs_that_were_not_by_one_camera() -> None:
    assert apart_warnings([]) == []
    (warning,) = apart_warnings([["a.jpg", "b.jpg"], ["c.jpg"]])
    assert "mapped again with 2 cameras (2 photographs: a.jpg, b.jpg; 1 photograph: c.jpg)" in warning
    assert "--set camera.mode=per_folder" in warning


def camera(
    params: list[float], deviations: list[float] | None, correlated: Sequence[tuple[str, str, float]] = ()
) -> dict[str, Any]:
    return {
        "model": "SIMPLE_RADIAL",
        "names": ["f", "cx", "cy", "k"],
        "params": params,
        "standard_deviations": deviations,
        "correlated": list(correlated),
        "photographs": 4,
        "width": 1000,
        "height": 800,
    }


def test_calibrations_that_are_doubtful() -> None:
    sound = camera([1200, 505, 396, -0.1], [1.0, 2.0, 2.0, 0.001])
    kept = camera([1200, 500, 400, -0.1], None)
    assert doubtful_calibrations([sound, kept]) == []
    (weak,) = doubtful_calibrations([camera([1200, 505, 396, -0.1], [7.0, 2.0, 12.0, 0.001])])
    assert "of 4 photographs (SIMPLE_RADIAL): f 1200 ± 7 px; cy 396 ± 12 px. Photographs" in weak
    tied = camera([1200, 505, 396, -0.1], [1.0, 2.0, 2.0, 0.001], [("f", "k", -0.97)])
    (said,) = doubtful_calibrations([tied])
    assert "f and k stand for each other (-0.97)" in said
    (off,) = doubtful_calibrations([camera([1200, 540, 400, -0.1], [1.0, 2.0, 2.0, 0.001])])
    assert "came out 4.0 % of the longer side off the middle" in off


def test_principal_points_that_photographs_hardly_tell() -> None:
    """Of any lens it is known to 1 % of the longer side: photographs cannot leave it less sure than that."""
    half = camera([1200, 505, 396, -0.1], [1.0, 4.9, 5.1, 0.001])
    (weak,) = doubtful_calibrations([half])
    assert "(SIMPLE_RADIAL): cy 396 ± 5 px. Photographs" in weak


def test_one_focal_length_is_named_once() -> None:
    names = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"]
    pairs = [("fx", "cx", 0.96), ("fy", "cx", 0.96)]

    def said(down: float) -> str:
        params, spread = [1200.0, down, 505, 396, 0.1, 0, 0, 0], [9.0, 9.0, 2, 2, 0.1, 0, 0, 0]
        (warning,) = doubtful_calibrations(
            [camera(params, spread, pairs) | {"model": "OPENCV", "names": names}]
        )
        return warning.partition("(OPENCV): ")[2].partition(". Photographs")[0]

    assert said(1200.0) == "fx 1200 ± 9 px; fx and cx stand for each other (0.96)"
    assert said(1190.0).startswith("fx 1200 ± 9 px; fy 1190 ± 9 px; fx and cx")


def test_a_richer_model_that_points_held_out_speak_against() -> None:
    assert refused_calibrations(None) == refused_calibrations(HeldOut(0.4, 0.41, -1.9)) == []
    (warning,) = refused_calibrations(HeldOut(0.4, 0.5, -2.1))
    assert "(0.500 px off, by COLMAP's own model 0.400 px): COLMAP's is kept" in warning
