"""Write sheets of coded targets as PDF, at true size, with rulers to check the printer by."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from colmap_ihe.errors import CapabilityError, OptionError
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.survey import sheet_layout as layout
from colmap_ihe.survey.sheet_layout import Place
from colmap_ihe.survey.targets import BORDER_CELLS, DEFAULT_DICTIONARY, dictionary_of, target_name

_POINTS = 72 / 25.4  # a millimetre, in the unit of PDF
_LINE_MM, _CUT_MM = 0.15, 3.0
_SPOT_CELLS, _DOT_CELLS = (
    0.15,
    0.06,
)  # radii of the mark of the centre: too small to make a cell another colour
_TICK_CELLS = (1.2, 1.9)  # where marks in line with the centre begin and end, from the black square outwards
_TEXT_MM = 2.8


def write_sheet(
    file: Path, size_mm: float, count: int, dictionary: str = DEFAULT_DICTIONARY, first: int = 0
) -> int:
    """Write `count` targets from number `first` on, of `size_mm` from edge to edge of the black square, and return the
    number of pages. Raises `OptionError` for what cannot be printed or a file that is there, `CapabilityError` without
    reportlab."""
    if file.exists():
        raise OptionError(f"{file}: is there already", hint="delete it, or name another file")
    known = dictionary_of(dictionary)
    numbers = _numbers(count, first, len(known.bytesList), dictionary)
    cells = known.markerSize + 2 * BORDER_CELLS
    sheets = layout.places(numbers, size_mm, cells)
    words = f"{dictionary}, black square {size_mm:g} mm"
    content = BytesIO()
    canvas = _canvas(content)
    for page, places in enumerate(sheets, start=1):
        canvas.scale(_POINTS, _POINTS)
        for place in places:
            _draw_target(canvas, place, _white_cells(known, place.number, cells), dictionary)
        _draw_rulers(canvas, f"{words}. Sheet {page} of {len(sheets)}")
        canvas.showPage()
    canvas.save()
    write_bytes(file, content.getvalue())
    return len(sheets)


def _numbers(count: int, first: int, known: int, dictionary: str) -> range:
    if count < 1 or first < 0 or first + count > known:
        raise OptionError(
            f"targets {first} to {first + count - 1} of {dictionary}: it has those from 0 to {known - 1}",
            hint="give another --count or --first",
        )
    return range(first, first + count)


def _canvas(content: BytesIO) -> Any:
    try:
        from reportlab.pdfgen.canvas import Canvas
    except ImportError as error:
        raise CapabilityError(
            "sheets of targets need the package reportlab, which is not installed",
            hint="in the clone of colmap-ihe: pip install '.[survey]'",
        ) from error
    width, height = layout.PAGE_MM
    canvas = Canvas(content, pagesize=(width * _POINTS, height * _POINTS), invariant=1)
    canvas.setTitle("Coded targets")
    canvas.setViewerPreference("PrintScaling", "None")
    return canvas


def _white_cells(dictionary: cv2.aruco.Dictionary, number: int, cells: int) -> npt.NDArray[np.bool_]:
    """Return (cells, cells): which cells are white, from the top row down."""
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, cells)) > 0


def _draw_target(canvas: Any, place: Place, white: npt.NDArray[np.bool_], dictionary: str) -> None:
    cell = place.size / len(white)
    canvas.setFillGray(0)
    canvas.rect(place.left, place.bottom, place.size, place.size, stroke=0, fill=1)
    canvas.setFillGray(1)
    path = canvas.beginPath()  # one for all cells: between two that touch no line is seen
    for row, column in np.argwhere(white):
        path.rect(place.left + column * cell, place.bottom + place.size - (row + 1) * cell, cell, cell)
    canvas.drawPath(path, stroke=0, fill=1)
    _draw_centre(canvas, place, cell)
    _draw_cut_marks(canvas, place)
    canvas.setFillGray(0)
    left, below, right, _ = place.tile
    name = target_name(place.number)
    height = min(_TEXT_MM, (right - left) / 10)
    canvas.setFont("Helvetica-Bold", 1.4 * height)
    canvas.drawString(left + _CUT_MM, below + 1.5, name)
    canvas.setFont("Helvetica", 0.8 * height)
    canvas.drawRightString(right - _CUT_MM, below + 1.5, f"{dictionary}  {place.size:g} mm")


def _draw_centre(canvas: Any, place: Place, cell: float) -> None:
    """Mark the centre by a black dot in a white one, and by ticks in line with it in the white around the target."""
    x, y = place.left + place.size / 2, place.bottom + place.size / 2
    canvas.circle(x, y, _SPOT_CELLS * cell, stroke=0, fill=1)
    canvas.setFillGray(0)
    canvas.circle(x, y, _DOT_CELLS * cell, stroke=0, fill=1)
    canvas.setLineWidth(_LINE_MM)
    near, far = (place.size / 2 + cells * cell for cells in _TICK_CELLS)
    for across, up in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        canvas.line(x + near * across, y + near * up, x + far * across, y + far * up)


def _draw_cut_marks(canvas: Any, place: Place) -> None:
    left, bottom, right, top = place.tile
    canvas.setLineWidth(_LINE_MM)
    canvas.setStrokeGray(0.6)
    for x, inward in ((left, 1), (right, -1)):
        for y, upward in ((bottom, 1), (top, -1)):
            canvas.line(x, y, x + inward * _CUT_MM, y)
            canvas.line(x, y, x, y + upward * _CUT_MM)
    canvas.setStrokeGray(0)


def _draw_rulers(canvas: Any, words: str) -> None:
    """Draw a ruler across and a ruler up, for printers that stretch one way, and say what they are for."""
    canvas.setLineWidth(_LINE_MM)
    canvas.setFillGray(0)
    (x, y), (side_x, side_y) = layout.RULERS_MM
    canvas.line(x, y, x + layout.RULER_MM, y)
    canvas.line(side_x, side_y, side_x, side_y + layout.RULER_MM)
    for tick in range(int(layout.RULER_MM) + 1):
        length = 4.0 if tick % 10 == 0 else 3.0 if tick % 5 == 0 else 1.5
        canvas.line(x + tick, y, x + tick, y + length)
        canvas.line(side_x, side_y + tick, side_x - length, side_y + tick)
    canvas.setFont("Helvetica", _TEXT_MM)
    canvas.drawString(x, y - 4, f"Both rulers must measure {layout.RULER_MM:g} mm: print at 100 %. {words}")
