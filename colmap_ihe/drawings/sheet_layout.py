"""Lay a drawing out on sheets of paper at a scale.

Millimetres from the lower left corner of a sheet, y up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from colmap_ihe.drawings.grid import nice_size

PAPERS = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0)}
MARGIN, BLOCK, LABELS = 10.0, 34.0, 7.0
"""White at the edges of a sheet; height of the title block; width of the strip around the drawing for its labels."""

_NOT_TO_SCALE = "A3"
_LONGEST_BAR, _BESIDE_BAR = 110.0, 32.0  # millimetres of a scale bar, and of what stands beside it
_GRID_STEP = 35.0  # millimetres between the lines of the grid, at least


@dataclass(frozen=True)
class Sheet:
    """Describe a sheet: the paper by name, its `size`, how many millimetres a unit of the model is on it, and the part
    of the drawing that it shows: `left` and `bottom` across and up, `width` and `height`. `part` of `parts`, from 1."""

    paper: str
    size: tuple[float, float]
    a_unit: float
    left: float
    bottom: float
    width: float
    height: float
    part: int = 1
    parts: int = 1

    @property
    def origin(self) -> tuple[float, float]:
        """Return where `left` and `bottom` are on the paper: the drawing is in the middle of its field."""
        left, bottom, width, height = field_of(self.size)
        return (
            left + (width - self.width * self.a_unit) / 2,
            bottom + (height - self.height * self.a_unit) / 2,
        )

    def on_paper(self, across: float, up: float) -> tuple[float, float]:
        """Return where a place of the drawing is on the paper."""
        x, y = self.origin
        return x + (across - self.left) * self.a_unit, y + (up - self.bottom) * self.a_unit


def field_of(size: tuple[float, float]) -> tuple[float, float, float, float]:
    """Return left, bottom, width and height of what a sheet leaves for the drawing."""
    width, height = size[0] - 2 * (MARGIN + LABELS), size[1] - 2 * (MARGIN + LABELS) - BLOCK
    return MARGIN + LABELS, MARGIN + LABELS + BLOCK, width, height


def sheets_for(left: float, bottom: float, right: float, top: float, scale: int | None) -> Iterator[Sheet]:
    """Yield the sheets for a rectangle of a drawing at 1:`scale`: the smallest paper that it fits on, or else as many
    sheets of the largest as it needs, row by row from the top left. With None, of a model that is not metric, one sheet
    that it fills."""
    width, height = max(right - left, 1e-9), max(top - bottom, 1e-9)
    if scale is None:
        short, long = PAPERS[_NOT_TO_SCALE]
        size = (long, short) if width >= height else (short, long)
        *_, across, up = field_of(size)
        yield Sheet(_NOT_TO_SCALE, size, min(across / width, up / height), left, bottom, width, height)
        return
    a_unit = 1000 / scale
    for paper, (short, long) in PAPERS.items():
        for size in ((long, short), (short, long)):
            *_, across, up = field_of(size)
            if width * a_unit <= across and height * a_unit <= up:
                yield Sheet(paper, size, a_unit, left, bottom, width, height)
                return
    short, long = PAPERS["A1"]
    *_, across, up = field_of((long, short))
    columns, rows = -int(-width * a_unit // across), -int(-height * a_unit // up)
    for number in range(columns * rows):
        row, column = divmod(number, columns)
        x, y = left + column * across / a_unit, top - (row + 1) * up / a_unit
        part = (number + 1, columns * rows)
        yield Sheet("A1", (long, short), a_unit, x, y, across / a_unit, up / a_unit, *part)


def bar_length(sheet: Sheet) -> float:
    """Return how long a scale bar is, in units of the model, so that half of the title block has room for it."""
    return nice_size(min(_LONGEST_BAR, (sheet.size[0] - 2 * MARGIN) / 2 - _BESIDE_BAR) / sheet.a_unit)


def grid_step(a_unit: float) -> float:
    """Return the step of the grid in units of the model: 1, 2 or 5 times a power of ten."""
    least = _GRID_STEP / a_unit
    power = 10.0 ** math.floor(math.log10(least))
    return next(n * power for n in (1.0, 2.0, 5.0, 10.0) if n * power >= least * (1 - 1e-9))
