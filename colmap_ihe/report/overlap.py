"""Draw how many photographs see each place of a model, and where its cameras stand, for the templates of a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.report.survey_contents import CameraPlan, OverlapMap

PLAN_WIDTH = 640.0  # units of the drawing of a plan
_EDGE = 30.0  # of the plan, free of cameras
_TALLEST = 1.1  # of the plan's width
_LOOK = 18.0  # units that a camera is drawn long
_HALF_WIDTH = 0.45  # of its length
_NUMBERED = 60  # cameras; the numbers of more would cover them
_CLASSES = ((1, "1 or 2"), (3, "3"), (4, "4 or 5"), (6, "6 to 9"), (10, "10 or more"))
_BAR_SHARE = 0.25  # of the plan: the longest bar of lengths


@dataclass(frozen=True)
class MapPart:
    """Hold the squares of a map that so many photographs see, in words: a path in steps, and their share of all."""

    photographs: str
    path: str
    share: float


@dataclass(frozen=True)
class MapDrawing:
    """Hold a map of `width` by `height` squares. `narrow`: a path of dots on places that all see from one side."""

    view: str
    width: int
    height: int
    parts: Sequence[MapPart]
    narrow: str


@dataclass(frozen=True)
class DrawnCamera:
    """Hold a camera of a plan: its `path`, a triangle that opens to where it looks, and its `number` at x, y."""

    path: str
    x: float
    y: float
    number: str


@dataclass(frozen=True)
class PlanDrawing:
    """Hold a plan: `ground` as a path, the cameras, and a bar of `bar` units that is `bar_length` of the model long."""

    view: str
    height: float
    ground: str
    cameras: Sequence[DrawnCamera]
    bar: float
    bar_length: float


def map_drawing(overlap: OverlapMap) -> MapDrawing | None:
    """Return a map as the templates draw it, None without places."""
    if not len(overlap.cells):
        return None
    width, height = (int(n) + 1 for n in overlap.cells.max(axis=0))
    corners = np.stack([overlap.cells[:, 0], height - 1 - overlap.cells[:, 1]], axis=1)
    kind = np.searchsorted([least for least, _ in _CLASSES], overlap.photographs, side="right") - 1
    parts = [
        MapPart(words, _squares(corners[kind == number], 1.0, 0.0, 0.0), float(np.mean(kind == number)))
        for number, (_, words) in enumerate(_CLASSES)
    ]
    dots = "".join(f"M{x}.5 {y}.5h0" for x, y in corners[overlap.narrow].tolist())
    return MapDrawing(overlap.view, width, height, parts, dots)


def _squares(cells: NDArray[np.int64], side: float, left: float, top: float) -> str:
    """Return a path of squares (n, 2), by steps of `side` to the right and down from a corner; those beside one another
    in a row are one."""
    cells = cells[np.lexsort((cells[:, 0], cells[:, 1]))]
    starts = np.ones(len(cells), bool)
    starts[1:] = (np.diff(cells, axis=0) != (1, 0)).any(axis=1)
    first = np.flatnonzero(starts)
    lengths = np.diff(np.append(first, len(cells)))
    path = []
    for (column, row), length in zip(cells[first].tolist(), lengths.tolist(), strict=True):
        x, y, wide = (round(value, 1) for value in (left + column * side, top + row * side, length * side))
        path.append(f"M{x:g} {y:g}h{wide:g}v{round(side, 1):g}h-{wide:g}z")
    return "".join(path)


def plan_drawing(plan: CameraPlan, numbers: Mapping[str, int]) -> PlanDrawing:
    """Return a plan as the templates draw it; `numbers` of the photographs, by name."""
    places = np.concatenate([plan.centres, plan.ground])
    low, extent = places.min(axis=0), np.maximum(np.ptp(places, axis=0), 1e-9)
    room = PLAN_WIDTH - 2 * _EDGE
    scale = room / max(float(extent[0]), float(extent[1]) / _TALLEST)
    height = float(extent[1]) * scale + 2 * _EDGE
    left = (PLAN_WIDTH - float(extent[0]) * scale) / 2

    def drawn(points: NDArray[np.float64]) -> NDArray[np.float64]:
        across, up = ((points - low) * scale).T
        return np.stack([across + left, height - _EDGE - up], axis=1)

    side = plan.side * scale
    shown = len(plan.names) <= _NUMBERED
    cameras = [
        _camera(centre, look * (1, -1), str(numbers.get(name, "")) if shown else "")
        for centre, look, name in zip(drawn(plan.centres), plan.directions, plan.names, strict=True)
    ]
    length = _round_length(_BAR_SHARE * room / scale)
    corners = drawn(plan.ground) - side / 2
    left_top = corners.min(axis=0)
    steps = np.rint((corners - left_top) / side).astype(np.int64)
    ground = _squares(steps, side, float(left_top[0]), float(left_top[1]))
    return PlanDrawing(plan.view, height, ground, cameras, length * scale, length)


def _camera(centre: NDArray[np.float64], look: NDArray[np.float64], number: str) -> DrawnCamera:
    end, across = centre + _LOOK * look, _LOOK * _HALF_WIDTH * np.array([-look[1], look[0]])
    corners = (end + across, end - across)
    path = f"M{centre[0]:.1f} {centre[1]:.1f}" + "".join(f"L{x:.1f} {y:.1f}" for x, y in corners) + "z"
    length = float(np.hypot(*look)) or 1.0
    x, y = centre - 12.0 * look / length
    return DrawnCamera(path, float(x), float(y) + 5.0, number)


def _round_length(most: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20 ..., or of their tenths, that is no longer."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(n for n in (1, 2, 5) if n * power <= most * (1 + 1e-9)))
