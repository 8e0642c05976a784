"""Lay coded targets out on sheets of A4.

Millimetres from the lower left corner of a sheet, y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from colmap_ihe.errors import OptionError

PAGE_MM = (210.0, 297.0)
MARGIN_CELLS = 2
"""White that a target has around its black square, in its own cells."""

RULER_MM = 100.0
RULERS_MM = ((20.0, 14.0), (14.0, 20.0))
"""Where the ruler across and the ruler up begin."""

LABEL_MM = 6.0
"""Height of the strip with the name, below the white of a target."""

_FREE_MM = (20.0, 24.0, 200.0, 287.0)  # left, bottom, right, top: what the rulers and most printers leave
_GAP_MM = 2.0
_SMALLEST_MM = 5.0


@dataclass(frozen=True)
class Place:
    """Describe where a target is on its sheet: `left` and `bottom` of its black square. `margin` is the width of its
    white."""

    number: int
    left: float
    bottom: float
    size: float
    margin: float

    @property
    def tile(self) -> tuple[float, float, float, float]:
        """Return left, bottom, right and top of what is cut out: the target, its white and its name."""
        far = self.size + self.margin
        below = self.bottom - self.margin - LABEL_MM
        return self.left - self.margin, below, self.left + far, self.bottom + far


def places(numbers: Sequence[int], size_mm: float, cells: int) -> list[list[Place]]:
    """Return the targets of each sheet, row by row from the top left. `cells` is the number of cells along a side.
    Raises `OptionError` for a size that a sheet has no room for, or that no printer prints well."""
    margin = MARGIN_CELLS * size_mm / cells
    left, bottom, right, top = _FREE_MM
    width, height = size_mm + 2 * margin, size_mm + 2 * margin + LABEL_MM
    columns = int((right - left + _GAP_MM) // (width + _GAP_MM))
    rows = int((top - bottom + _GAP_MM) // (height + _GAP_MM))
    if size_mm < _SMALLEST_MM or not columns or not rows:
        most = int(min(right - left, top - bottom - LABEL_MM) / (1 + 2 * MARGIN_CELLS / cells))
        raise OptionError(
            f"targets of {size_mm:g} mm cannot be printed on A4",
            hint=f"give a size from {_SMALLEST_MM:g} to {most} mm",
        )
    sheets: list[list[Place]] = []
    for index, number in enumerate(numbers):
        row, column = divmod(index % (rows * columns), columns)
        if not row and not column:
            sheets.append([])
        x = left + column * (width + _GAP_MM) + margin
        y = top - row * (height + _GAP_MM) - margin - size_mm
        sheets[-1].append(Place(number, x, y, size_mm, margin))
    return sheets
