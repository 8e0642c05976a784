"""Show how well a model agrees with its survey: as tables, and as a plan with the errors drawn larger."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_ihe.report.tables import Table

Record = Mapping[str, Any]
"""The record of the stage `survey`: see pipeline/survey_records.py."""

_SIDE, _EDGE = 640.0, 40.0  # of the plan, in units of its drawing
_LONGEST = 0.12  # of the plan: the longest error
_FEWEST = 2  # points of a plan


@dataclass(frozen=True)
class PlanPoint:
    """Place a point of the plan, in units of its drawing, with the end of its error drawn larger."""

    name: str
    role: str
    x: float
    y: float
    to_x: float
    to_y: float


@dataclass(frozen=True)
class Plan:
    """Hold the points of a survey as seen from above or from the front; `times`: how many times larger errors are
    drawn; `view`: which, in words."""

    points: Sequence[PlanPoint]
    height: float
    times: int
    view: str


def survey_tables(record: Record) -> list[Table]:
    """Return the tables of a survey that there is something for: points, scale bars, camera positions."""
    tables = [_points(record["points"]), _bars(record["bars"]), _positions(record["positions"])]
    return [table for table in tables if table.rows]


def _points(points: Sequence[Mapping[str, Any]]) -> Table:
    columns = ("point", "role", "dX mm", "dY mm", "dZ mm", "expected ± mm", "photographs", "px RMS", "note")
    rows = []
    for p in sorted(points, key=lambda p: _natural(p["name"])):
        expected = f"{1000 * float(np.linalg.norm(p['deviation_m'])):.1f}" if p["deviation_m"] else ""
        pixels = "" if p["error_px"] is None else f"{p['error_px']:.2f}"
        rows.append(
            (
                p["name"],
                p["role"],
                *_millimetres(p["delta_m"]),
                expected,
                f"{p['sights']}",
                pixels,
                p["reason"],
            )
        )
    return Table("points", "Points: where the model has them less where they were surveyed", columns, rows)


def _bars(bars: Sequence[Mapping[str, Any]]) -> Table:
    rows = [
        (
            bar["name"],
            f"{bar['length_m']:.4f}",
            "" if bar["delta_m"] is None else f"{1000 * bar['delta_m']:+.2f}",
            bar["reason"],
        )
        for bar in bars
    ]
    return Table("scale-bars", "Scale bars", ("bar", "measured m", "in the model mm", "note"), rows)


def _positions(positions: Sequence[Mapping[str, Any]]) -> Table:
    rows = [(p["image"], *_millimetres(p["delta_m"]), p["reason"]) for p in positions]
    columns = ("photograph", "dX mm", "dY mm", "dZ mm", "note")
    return Table("positions", "Camera positions: the model's less the measured", columns, rows)


def _natural(name: str) -> tuple[str, int, str]:
    """Return what sorts T2 before T10."""
    letters = name.rstrip("0123456789")
    return letters, int(name[len(letters) :] or 0), name


def _millimetres(delta: Sequence[float] | None) -> tuple[str, str, str]:
    if delta is None:
        return "", "", ""
    x, y, z = (f"{1000 * value:+.1f}" for value in delta)
    return x, y, z


def survey_plan(record: Record) -> Plan | None:
    """Return the points with their errors, seen from where they spread most: from above, or from the front of a façade;
    None of fewer than two."""
    points = [p for p in record["points"] if p["surveyed"] and p["delta_m"]]
    degrees = record["frame"] is not None and record["frame"]["origin"] is not None
    if len(points) < _FEWEST or degrees:
        return None
    places = np.array([p["surveyed"] for p in points], np.float64)
    errors = np.array([p["delta_m"] for p in points], np.float64)
    spread = np.ptp(places, axis=0)
    above = spread[1] >= spread[2]
    axes = [0, 1] if above else [0, 2]
    extent = np.maximum(spread[axes], 1e-9)
    scale = (_SIDE - 2 * _EDGE) / float(extent.max())
    longest = float(np.linalg.norm(errors[:, axes], axis=1).max())
    times = max(1, _rounded(_LONGEST * float(extent.max()) / max(longest, 1e-9)))
    height = float(scale * extent[1] + 2 * _EDGE)
    flat = (places[:, axes] - places[:, axes].min(axis=0)) * scale + _EDGE
    ends = flat + errors[:, axes] * scale * times
    drawn = [
        PlanPoint(p["name"], p["role"], x, height - y, to_x, height - to_y)
        for p, (x, y), (to_x, to_y) in zip(points, flat.tolist(), ends.tolist(), strict=True)
    ]
    return Plan(
        drawn, height, times, "from above (x right, y up)" if above else "from the front (x right, z up)"
    )


def _rounded(value: float) -> int:
    """Return the largest of 1, 2, 5, 10, 20 ... that is no larger."""
    power = 10 ** int(np.floor(np.log10(max(value, 1))))
    return int(power * max(n for n in (1, 2, 5) if n * power <= max(value, 1)))
