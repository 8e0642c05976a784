"""What the summary says of a survey."""

from __future__ import annotations

from colmap_ihe.pipeline.survey_records import survey_record, survey_summary
from colmap_ihe.survey.accuracy import BarAccuracy, PointAccuracy, PositionAccuracy
from colmap_ihe.survey.frames import Frame
from colmap_ihe.survey.georeference import Georeferenced


def point(name: str, role: str, x: float, used: bool) -> PointAccuracy:
    return PointAccuracy(name, role, (0, 0, 0), (x, 0, 0), (0.01, 0, 0), 3, 0.1, used)


def test_root_mean_squares_are_of_what_took_part_and_of_check_points() -> None:
    points = [point("A", "control", 0.003, True), point("B", "control", 1.0, False)]
    points += [point("C", "check", 0.003, False), point("D", "check", 0.004, False)]
    bars = [BarAccuracy("a to b", 2.0, -0.001, True), BarAccuracy("a to c", 2.0, 0.5, False, "off")]
    positions = [PositionAccuracy("1.png", (0.3, 0, 0.4), True)]
    result = Georeferenced("control_points", Frame("EPSG:25832"), None, True, points, bars, positions)
    record = survey_record(result, {"1.png": "1.jpg"}).model_dump()
    assert record["positions"][0]["image"] == "1.jpg"
    summary = survey_summary(record)
    assert (summary["metric"], summary["crs"]) == (True, "EPSG:25832")
    assert (summary["control_points"], summary["check_points"]) == (1, 2)
    errors = [round(summary[f"{name}_rms_mm"], 6) for name in ("control", "check", "scale_bar")]
    assert errors == [3.0, 3.535534, 1.0]
    assert summary["position_rms_m"] == 0.5


def test_without_survey_nothing_is_said_and_without_scale_that_there_is_none() -> None:
    assert survey_summary({})["metric"] is None
    record = survey_record(Georeferenced(), {}).model_dump()
    assert survey_summary(record)["metric"] is False
