"""The tables and the plan of a survey."""

from __future__ import annotations

from typing import Any

import pytest

from colmap_ihe.report.survey import survey_plan, survey_tables


def point(
    name: str, surveyed: tuple[float, float, float], delta: tuple[float, float, float]
) -> dict[str, Any]:
    shared = {"role": "control", "deviation_m": (0.003, 0.004, 0.0), "sights": 4, "error_px": 0.123}
    return {"name": name, "surveyed": surveyed, "delta_m": delta, "used": True, "reason": "", **shared}


RECORD: dict[str, Any] = {
    "points": [point("P10", (0, 0, 0), (0.001, 0, -0.002)), point("P2", (10, 0, 5), (0, 0, 0))],
    "bars": [{"name": "A to B", "length_m": 2.0, "delta_m": -0.0004, "used": True, "reason": ""}],
    "positions": [],
    "frame": {"origin": None},
}


def test_tables_have_millimetres_and_points_in_the_order_of_their_numbers() -> None:
    points, bars = survey_tables(RECORD)
    assert points.rows[0][0] == "P2"
    assert points.rows[1] == ("P10", "control", "+1.0", "+0.0", "-2.0", "5.0", "4", "0.12", "")
    assert bars.rows == [("A to B", "2.0000", "-0.40", "")]


def test_the_plan_shows_errors_larger_and_is_seen_from_the_front_of_a_facade() -> None:
    plan = survey_plan(RECORD)
    assert plan is not None
    assert plan.view.startswith("from the front")
    first, second = plan.points
    assert (second.x - first.x, first.y - second.y) == pytest.approx((560, 280))
    assert first.to_x - first.x == pytest.approx(0.001 * 56 * plan.times)
    assert first.to_y - first.y == pytest.approx(0.002 * 56 * plan.times)
    assert plan.times == 500  # the largest of 1, 2, 5 ... with which 2.24 mm stay within 0.12 of 10 m
    assert survey_plan({**RECORD, "points": RECORD["points"][:1]}) is None
