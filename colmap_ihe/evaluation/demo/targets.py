"""Put coded targets on the portico, and survey them.

    FOLDER/control/points.csv       name, x, y, z, accuracy_m, role of ten targets: five control, five check points
    FOLDER/control/scalebars.csv    a, b, length_m, accuracy_m between four more

Coordinates are those of the scene in metres, each off by a normal error of `POINT_M`, lengths by one of `BAR_M`: what a
total station and a steel tape do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from colmap_ihe.evaluation.demo.grid import F32, F64, Grid
from colmap_ihe.evaluation.demo.materials import Material, colour
from colmap_ihe.evaluation.demo.scene import Patch
from colmap_ihe.evaluation.demo.shapes import Rect
from colmap_ihe.survey.targets import BORDER_CELLS, DEFAULT_DICTIONARY, dictionary_of, target_name

SIDE_M = 0.30
"""Of the black square: some 30 pixels of the demo's photographs."""

POINT_M, BAR_M = 0.001, 0.0005
"""Standard deviation of each surveyed coordinate, and of the length of a scale bar."""

LEAST_WIDTH = 1000
"""Pixels: photographs that are less wide do not show what a target says, and the scene then has none."""

_MARGIN_CELLS = 1.5
_BOARD_M = 0.008  # how far a board stands out of its wall
_FINER = 8
_WHITE, _BLACK = (0.90, 0.89, 0.87), (0.16, 0.16, 0.16)
_SEED = 7727


@dataclass(frozen=True)
class SurveyTarget:
    """Describe a target that faces the photographer: its number, the place (x, y, z) of the wall behind its centre, and
    what it is there for."""

    number: int
    wall: tuple[float, float, float]
    role: str

    @property
    def centre(self) -> F64:
        """Return (3,): its true centre in the world."""
        x, y, z = self.wall
        return np.array((x, y - _BOARD_M, z))


TARGETS = (
    SurveyTarget(1, (-4.98, 0.0, 1.3), "control"),
    SurveyTarget(2, (4.98, 0.0, 1.3), "control"),
    SurveyTarget(3, (-5.65, -1.05, 4.76), "control"),
    SurveyTarget(4, (5.65, -1.05, 4.76), "control"),
    SurveyTarget(5, (0.0, -1.05, 5.72), "control"),
    SurveyTarget(6, (-4.98, 0.0, 3.4), "check"),
    SurveyTarget(7, (2.3, -1.05, 5.72), "check"),
    SurveyTarget(8, (-3.6, 3.6, 0.92), "check"),
    SurveyTarget(9, (1.3, 3.6, 0.92), "check"),
    SurveyTarget(10, (1.4, 0.0, 1.9), "check"),
    SurveyTarget(11, (-4.75, -1.05, 5.72), "bar"),
    SurveyTarget(12, (4.75, -1.05, 5.72), "bar"),
    SurveyTarget(13, (-1.4, 0.0, 1.3), "bar"),
    SurveyTarget(14, (4.98, 0.0, 3.4), "bar"),
)
_BARS = ((11, 12), (13, 14))


def target_patches() -> tuple[Patch, ...]:
    """Return a white board with its target for each of `TARGETS`."""
    return tuple(Patch(_board(target), _painted(target.number)) for target in TARGETS)


def control_files(seed: int) -> dict[str, str]:
    """Return the texts of the files in control/, by name."""
    rng = np.random.default_rng((seed, _SEED))
    points = ["name,x,y,z,accuracy_m,role"]
    surveyed = [target for target in TARGETS if target.role != "bar"]
    errors = rng.normal(0, 1, (len(surveyed), 3))
    errors *= POINT_M / np.sqrt(np.mean(errors**2))  # few draws would be off by more or less than is said
    for target, error in zip(surveyed, errors, strict=True):
        x, y, z = target.centre + error
        points.append(f"{target_name(target.number)},{x:.4f},{y:.4f},{z:.4f},{POINT_M:g},{target.role}")
    centres = {target.number: target.centre for target in TARGETS}
    bars = ["a,b,length_m,accuracy_m"]
    for one, other in _BARS:
        length = float(np.linalg.norm(centres[one] - centres[other])) + rng.normal(0, BAR_M)
        bars.append(f"{target_name(one)},{target_name(other)},{length:.4f},{BAR_M:g}")
    return {"points.csv": "\n".join(points) + "\n", "scalebars.csv": "\n".join(bars) + "\n"}


def _board(target: SurveyTarget) -> Rect:
    x, y, z = target.centre
    half = SIDE_M * (0.5 + _MARGIN_CELLS / _cells())
    return Rect(1, y, (x - half, z - half), (x + half, z + half), -1)


def _cells() -> int:
    return int(dictionary_of(DEFAULT_DICTIONARY).markerSize) + 2 * BORDER_CELLS


def _painted(number: int) -> Material:
    return partial(paint_target, number=number)


def paint_target(grid: Grid, number: int) -> F32:
    """Paint target `number` on white, its cells mixed where an edge crosses a texel."""
    rows, columns = grid.shape
    cell = int(np.ceil(_FINER * max(rows, columns) / _cells() / 2)) * 2
    marker = cv2.aruco.generateImageMarker(dictionary_of(DEFAULT_DICTIONARY), number, _cells() * cell)
    framed = np.pad(marker, round(_MARGIN_CELLS * cell), constant_values=255)
    share = cv2.resize(framed.astype(np.float32) / 255, (columns, rows), interpolation=cv2.INTER_AREA)
    black, white = colour(*_BLACK), colour(*_WHITE)
    return np.asarray(black + (white - black) * np.asarray(share)[..., None], np.float32)
