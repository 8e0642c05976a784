"""The line on scale and accuracy."""

from __future__ import annotations

from typing import Any

from colmap_ihe.report.survey_words import survey_in_words

NONE: dict[str, Any] = {
    "metric": False,
    "metric_by": None,
    "crs": None,
    "control_rms_mm": None,
    "check_rms_mm": None,
    "scale_bar_rms_mm": None,
    "position_rms_m": None,
    "control_points": 0,
    "check_points": 0,
}


def test_without_scale_it_says_what_to_do() -> None:
    assert survey_in_words(NONE | {"metric": None}) == ""
    assert "has no scale" in survey_in_words(NONE)
    assert "control/scalebars.csv" in survey_in_words(NONE)


def test_control_and_check_points_by_number_and_error() -> None:
    given = {"metric": True, "metric_by": "control_points", "crs": "EPSG:25832", "control_points": 6}
    summary = NONE | given | {"control_rms_mm": 4.06, "check_points": 1, "check_rms_mm": 5.2}
    assert survey_in_words(summary) == (
        "metres by control points in EPSG:25832; 6 control points 4.1 mm RMS; 1 check point 5.2 mm RMS"
    )
    by_gps = NONE | {"metric": True, "metric_by": "gps", "crs": "EPSG:4979", "position_rms_m": 2.345}
    assert survey_in_words(by_gps) == (
        "metres by GPS of the photographs in EPSG:4979; camera positions 2.35 m RMS"
    )
