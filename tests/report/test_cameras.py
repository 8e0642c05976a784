"""Cameras on the page: a table with a column for each, and a drawing of each lens that was calibrated."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.report.camera_words import camera_rows, gain_in_words
from colmap_ihe.report.cameras import LensChart, cameras_table, lens_charts


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
        "exif": {"make": "Foo", "model": "Foo Bar", "focal_length_mm": 24.0, "focal_length_35mm": 0.0},
    }
    return values | changes


STRANGER = camera(by="colmap", standard_deviations=None, photographs=1)
PANORAMA = camera(
    model="EQUIRECTANGULAR",
    by="colmap",
    parameters={"w": 1000.0, "h": 500.0},
    standard_deviations=None,
    exif=None,
)
HELD = camera(standard_deviations={"f": 1.26, "cx": 0.0, "cy": 0.0, "k": 0.0012})


def summary(*cameras: dict[str, Any], **error: Any) -> dict[str, Any]:
    return {
        "cameras": list(cameras) or None,
        "held_out_error_px": {"confirmed": True} | error if error else None,
    }


def test_what_the_terminal_says() -> None:
    (row, held_out) = camera_rows(summary(camera(), colmap=0.4, calibrated=0.3))
    assert row == (
        "camera",
        "SIMPLE_RADIAL, focal length 1200.0 ± 1.3 px, principal point (510.0 ± 2.0, 246.0 ± 3.0), 9 photographs",
    )
    assert held_out == ("held-out error", "0.300 px, with COLMAP's model 0.400 px")
    rows = camera_rows(summary(HELD, *[STRANGER] * 4))
    assert rows[0][1].startswith("Foo Bar at 24 mm: SIMPLE_RADIAL, ")
    assert "principal point (510.0, 246.0) held, 9" in rows[0][1]
    assert rows[1][1].endswith(
        "focal length 1200.0 px, principal point (510.0, 246.0), 1 photograph, not calibrated"
    )
    assert rows[3] == ("camera", "and 2 more, in report/summary.json")
    assert camera_rows(summary()) == []


def test_two_focal_lengths_are_across_and_down() -> None:
    def focal_length(across: float, down: float) -> str:
        parameters = {"fx": across, "fy": down, "cx": 500.0, "cy": 250.0}
        spread = dict.fromkeys(parameters, 1.0)
        (row,) = camera_rows(
            summary(camera(model="PINHOLE", parameters=parameters, standard_deviations=spread))
        )
        return row[1].partition(", principal")[0]

    assert focal_length(1000, 999) == "PINHOLE, focal length 1000.0 ± 1.0 across, 999.0 ± 1.0 down px"
    assert focal_length(1000, 1000) == "PINHOLE, focal length 1000.0 ± 1.0 px"


def test_a_panorama_has_no_focal_length() -> None:
    assert camera_rows(summary(PANORAMA)) == [
        ("camera", "EQUIRECTANGULAR, focal length - px, principal point -, 9 photographs, not calibrated")
    ]
    table = cameras_table([PANORAMA])
    assert table is not None
    assert [row[0] for row in table.rows] == [
        *("model", "photographs", "size", "focal length, px", "principal point, px", "from"),
    ]
    assert lens_charts([PANORAMA]) == []


def test_what_points_held_out_say() -> None:
    assert gain_in_words(summary()) == ""
    assert gain_in_words(summary(colmap=0.4, calibrated=0.3)).endswith(
        "as COLMAP begins with it (25 % less)."
    )
    assert gain_in_words(summary(colmap=0.4, calibrated=0.5)).endswith("(25 % more).")
    same = summary(colmap=0.4, calibrated=0.4)
    assert "call for no camera model that is richer" in gain_in_words(same)
    assert camera_rows(same)[0][1] == "0.400 px, which no richer camera model than COLMAP's betters"
    refused = summary(camera(), colmap=0.4, calibrated=0.5, confirmed=False)
    assert "by 0.400 px with COLMAP's own. So COLMAP's is kept" in gain_in_words(refused)
    assert camera_rows(refused)[1][1] == "0.500 px, with COLMAP's model 0.400 px, which was kept"


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
    assert rows["EXIF"] == ("Foo Bar at 24 mm", "Foo Bar at 24 mm")
    many = cameras_table([camera()] * 12)
    assert many is not None and len(many.columns) == 9 and many.title == "Cameras, the first 8 of 12"


def ends_of(chart: LensChart) -> NDArray[np.float64]:
    """(n, 2): where the lines end."""
    return np.array([float(v) for v in re.findall(r"-?[\d.]+", chart.arrows)]).reshape(-1, 4)[:, 2:]


def test_no_line_leaves_the_picture_or_makes_much_of_little() -> None:
    def drawn(k: float) -> LensChart:
        return lens_charts([camera(parameters={"f": 1000.0, "cx": 500.0, "cy": 250.0, "k": k})])[0]

    outwards, little = drawn(0.1), drawn(-0.0001)
    ends = ends_of(outwards)
    assert ends.min() == pytest.approx(0, abs=0.06) and (ends.max(axis=0) <= (640.05, 320.05)).all()
    assert little.times == 100
    assert "up to 0.0134 px off, drawn 100 times as long" in little.caption


def test_a_lens_is_drawn_where_it_shows_things() -> None:
    """Barrel distortion: at the corner of the grid r = 0.4485 focal lengths, so 10 % of its cube further in."""
    (chart,) = lens_charts([camera(parameters={"f": 1000.0, "cx": 500.0, "cy": 250.0, "k": -0.1}), STRANGER])
    corner = (0.5 - 0.5 / 13, 0.25 - 0.25 / 9)  # from the middle, in focal lengths
    radius = (corner[0] ** 2 + corner[1] ** 2) ** 0.5
    assert chart.longest_px == pytest.approx(1000 * 0.1 * radius**3, rel=1e-3)
    assert (chart.middle, chart.principal, chart.off_px) == ((320, 160), (320, 160), 0)
    assert chart.radii == pytest.approx((2 * 2 * 0.64, 2 * 3.04 * 0.64))
    assert "up to 13.4 px off" in chart.caption and "the blue ellipse is two standard" in chart.caption
    assert chart.dots.startswith("M24.6 17.8h0M73.8 17.8h0")
    x, y, u, v = (float(value) for value in re.findall(r"-?[\d.]+", chart.arrows)[:4])
    assert (x, y) == pytest.approx((24.6, 17.8), abs=0.06)  # the first of 13 by 9
    assert u > x and v > y  # inwards
    ends = ends_of(chart)
    assert np.hypot(*(ends[0] - (24.6, 17.8))) == pytest.approx(0.9 * 640 / 13, abs=0.1)
    (held,) = lens_charts([HELD])
    assert held.radii == (3, 3) and held.off_px == pytest.approx(116**0.5)
    assert held.caption.endswith("the blue dot the principal point, held 10.8 px off it.")


def test_a_lens_without_distortion_has_no_arrows_to_lengthen() -> None:
    parameters = {"f": 1000.0, "cx": 500.0, "cy": 250.0, "k": 0.0}
    (chart,) = lens_charts(
        [camera(parameters=parameters, standard_deviations=dict.fromkeys(parameters, 0.0))]
    )
    assert (chart.times, chart.arrows, round(chart.longest_px, 6)) == (0, "", 0)
    assert chart.caption.endswith("the middle of the picture, where the principal point was held.")


def test_a_fisheye_is_drawn_as_far_as_it_is_one() -> None:
    """At 300 pixels a radian, a place 471 pixels off the middle is beside the camera."""
    parameters = {"f": 300.0, "cx": 500.0, "cy": 250.0, "k": 0.01}
    (chart,) = lens_charts([camera(model="SIMPLE_RADIAL_FISHEYE", parameters=parameters)])
    assert chart.dots.count("h0") == 13 * 9 - 2 * 6
    assert chart.longest_px == pytest.approx(0.01 * np.hypot(461.5, 55.6) ** 3 / 300**2, rel=1e-3)
    assert chart.caption.startswith("The dots are where a fisheye without distortion")


def test_the_drawing_says_which_camera_of_the_table_it_is() -> None:
    first, second = lens_charts([camera(), STRANGER, camera()])
    assert first.title.startswith("Camera 1. SIMPLE_RADIAL") and second.caption.startswith(
        "Camera 3. The dots"
    )
    assert len(lens_charts([camera()] * 9)) == 4
