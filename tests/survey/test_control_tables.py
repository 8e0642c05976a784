"""Rows of a table and their numbers."""

from __future__ import annotations

import math

from colmap_ihe.survey.control_tables import Row


def test_a_comma_is_a_point_only_beside_semicolons() -> None:
    problems: list[str] = []
    assert Row(2, {"x": "1,5"}, True, problems).number("x") == 1.5
    assert problems == []
    assert math.isnan(Row(2, {"x": "1,5"}, False, problems).number("x"))
    assert Row(3, {}, False, problems).number("x", 7.0) == 7.0
    assert Row(4, {"name": " "}, False, problems).text("name") == ""
    assert problems == ["line 2: x is '1,5', expected a number", "line 4: name is empty"]
