"""Cameras on the page: a table with a column for each, and a drawing of each lens that was calibrated."""

from __future__ import annotations

import re
from typing import Any

import pytest

from colmap_ihe.report.camera_words import camera_rows
from colmap_ihe.report.cameras import cameras_table, lens_charts


def camera(**changes: Any) -> dict[str, Any]:
    values: dict[str, Any] = {
        "model": "SIMPLE_RADIAL",
        "width": 1000,
        "height": 500,
        "photographs": 9,
        "by": "calibration",
        "parameters": {"f": 1200.04, "cx": 510.0, "cy": 246.0, "k": -0.1},
        "standard_deviations": {"f": 1.26, "cx": 2.0, "cy": 3.04, "k": 0.0012},
        "doubtful": [],
    }
    return values | changes


STRANGER = camera(by="colmap", standard_deviations=None, photographs=1)
HELD = camera(standard_deviations={"f": 1.26, "cx": 0.0, "cy": 0.0, "k": 0.0012})


def test_what_the_terminal_says() -> None:
    error = {"colmap": 0.4, "calibrated": 0.3}
    (row, held_out) = camera_rows({"cameras": [camera()], "held_out_error_px": error})
    assert row == (
        "camera",
        "SIMPLE_RADIAL, focal length 1200.0 ± 1.3 px, principal point (510.0 ± 2.0, 246.0 ± 3.0), 9 photographs",
    )
    assert held_out == ("held-out error", "0.300 px, with COLMAP's model 0.400 px")
    rows = camera_rows({"cameras": [HELD, *[STRANGER] * 4], "held_out_error_px": None})
    assert "principal point (510.0 (held), 246.0 (held))" in rows[0][1]
    assert rows[1][1].endswith("focal length 1200.0 px, principal point (510.0, 246.0), 1 photograph")
    assert rows[3] == ("camera", "and 2 more, in report/summary.json")
    assert camera_rows({"cameras": None, "held_out_error_px": None}) == []


def test_the_table_has_a_column_for_each_camera() -> None:
    assert cameras_table([]) is None
    radial = camera(
        model="RADIAL",
        parameters={"f": 1100.0, "cx": 500.0, "cy": 250.0, "k1": -0.2, "k2": 0.05},
        standard_deviations={"f": 1.0, "cx": 0.0, "cy": 0.0, "k1": 0.01, "k2": 0.02},
    )
    table = cameras_table([camera(), radial])
    assert table is not None
    assert table.columns == ("camera", "1", "2")
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["focal length, px"] == ("1200.0 ± 1.3", "1100.0 ± 1.0")
    assert rows["k"] == ("-0.10000 ± 0.00120", "")
    assert rows["k2"] == ("", "0.05000 ± 0.02000")
    assert rows["from"] == ("calibrated", "calibrated")
    many = cameras_table([camera()] * 12)
    assert many is not None and len(many.columns) == 9 and many.title == "Cameras, the first 8 of 12"


def test_a_lens_is_drawn_where_it_shows_things() -> None:
    """Barrel distortion: at the corner of the grid r = 0.4485 focal lengths, so 10 % of its cube further in."""
    (chart,) = lens_charts([camera(parameters={"f": 1000.0, "cx": 500.0, "cy": 250.0, "k": -0.1}), STRANGER])
    corner = (0.5 - 0.5 / 13, 0.25 - 0.25 / 9)  # from the middle, in focal lengths
    radius = (corner[0] ** 2 + corner[1] ** 2) ** 0.5
    assert chart.longest_px == pytest.approx(1000 * 0.1 * radius**3, rel=1e-3)
    assert (chart.middle, chart.principal, chart.off_px) == ((320, 160), (320, 160), 0)
    assert chart.deviation == pytest.approx((2 * 2 * 0.64, 2 * 3.04 * 0.64))
    x, y, u, v = (float(value) for value in re.findall(r"-?[\d.]+", chart.arrows)[:4])
    assert (x, y) == pytest.approx((24.6, 17.8), abs=0.06)  # the first of 13 by 9
    assert u > x and v > y  # inwards
    (held,) = lens_charts([HELD])
    assert held.deviation is None and held.off_px == pytest.approx(116**0.5)


def test_a_lens_without_distortion_has_no_arrows_to_lengthen() -> None:
    (chart,) = lens_charts([camera(parameters={"f": 1000.0, "cx": 500.0, "cy": 250.0, "k": 0.0})])
    assert (chart.times, round(chart.longest_px, 6)) == (0, 0)
