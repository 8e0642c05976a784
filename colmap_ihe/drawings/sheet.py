"""Write drawings as sheets of PDF at a true scale, with grid, scale bar, arrow and title block."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.lines import Layer
from colmap_ihe.drawings.sheet_layout import BLOCK, MARGIN, Sheet, bar_length, grid_step, sheets_for
from colmap_ihe.errors import CapabilityError
from colmap_ihe.machine.files import write_bytes

_POINTS = 72 / 25.4  # a millimetre, in the unit of PDF
_LINE, _TEXT, _SMALL, _LARGE = 0.18, 2.6, 2.1, 4.5  # millimetres
_LINES = 6  # of the title block
_CROSS, _TICK = 2.0, 2.0  # millimetres, half of a cross of the grid, and a tick outside of the drawing
_ENCODING = "cp1252"  # what the fonts of every PDF reader have
_NOT_METRIC = "NOT TO SCALE: the model is not metric"


@dataclass(frozen=True)
class SheetContent:
    """Describe what a page shows: its `heading`; a picture as JPEG over a grid, if any; `layers` of lines; and the
    stops of a legend with its unit, if any."""

    heading: str
    layers: Sequence[Layer] = ()
    jpeg: bytes = b""
    grid: PixelGrid | None = None
    legend: Sequence[tuple[float, tuple[int, int, int]]] = ()
    unit: str = ""


@dataclass(frozen=True)
class SheetText:
    """Hold what the title block says: the title's lines by name as the user gave them, the drawing's name, and notes.
    `scale` is None for a model that is not metric. `shift` is added to across and up in the labels of the grid.
    `arrow`: what the arrow upwards means."""

    title: Mapping[str, str]
    name: str
    notes: Sequence[str]
    scale: int | None
    shift: tuple[float, float]
    arrow: str


def write_sheets(
    path: Path, contents: Sequence[SheetContent], bounds: tuple[float, float, float, float], text: SheetText
) -> list[str]:
    """Write a page or several for each of `contents`, all of the rectangle `bounds` (left, bottom, right, top), and
    return the papers, as A3, one a page. Raises `CapabilityError` without reportlab."""
    content = BytesIO()
    canvas = _canvas(content, text.name)
    papers = []
    for each in contents:
        for sheet in sheets_for(*bounds, text.scale):
            _page(canvas, each, sheet, text)
            papers.append(sheet.paper)
    canvas.save()
    write_bytes(path, content.getvalue())
    return papers


def _canvas(content: BytesIO, title: str) -> Any:
    try:
        from reportlab.pdfgen.canvas import Canvas
    except ImportError as error:
        raise CapabilityError(
            "sheets need the package reportlab, which is not installed",
            hint="pip install 'colmap-ihe[survey]'",
        ) from error
    canvas = Canvas(content, invariant=1)
    canvas.setTitle(_plain(title))
    canvas.setViewerPreference("PrintScaling", "None")
    return canvas


def letters_without_font(text: str) -> str:
    """Return the letters of a text that sheets show as question marks."""
    return "".join(sorted({letter for letter in text if _plain(letter) != letter}))


def _plain(text: str) -> str:
    return text.encode(_ENCODING, "replace").decode(_ENCODING)


def _page(canvas: Any, content: SheetContent, sheet: Sheet, text: SheetText) -> None:
    canvas.setPageSize((sheet.size[0] * _POINTS, sheet.size[1] * _POINTS))
    canvas.scale(_POINTS, _POINTS)
    canvas.saveState()
    x, y = sheet.origin
    clip = canvas.beginPath()
    clip.rect(x, y, sheet.width * sheet.a_unit, sheet.height * sheet.a_unit)
    canvas.clipPath(clip, stroke=0, fill=0)
    if content.grid is not None:
        _draw_picture(canvas, content.jpeg, content.grid, sheet)
    for layer in content.layers:
        _draw_layer(canvas, layer, sheet)
    canvas.restoreState()
    canvas.setLineWidth(_LINE)
    canvas.rect(x, y, sheet.width * sheet.a_unit, sheet.height * sheet.a_unit)
    if text.scale is not None:
        _draw_grid(canvas, sheet, text.shift)
    _draw_block(canvas, content, sheet, text)
    canvas.showPage()


def _draw_picture(canvas: Any, jpeg: bytes, grid: PixelGrid, sheet: Sheet) -> None:
    from reportlab.lib.utils import ImageReader

    x, y = sheet.on_paper(grid.left, grid.bottom)
    size = grid.width * grid.pixel * sheet.a_unit, grid.height * grid.pixel * sheet.a_unit
    canvas.drawImage(ImageReader(BytesIO(jpeg)), x, y, *size)


def _draw_layer(canvas: Any, layer: Layer, sheet: Sheet) -> None:
    canvas.setStrokeColorRGB(*(c / 255 for c in layer.colour))
    canvas.setLineWidth(layer.width_mm)
    canvas.setLineJoin(1)
    for line in layer.lines:
        path = canvas.beginPath()
        first, *others = [sheet.on_paper(u, v) for u, v in line.points.tolist()]
        path.moveTo(*first)
        for point in others:
            path.lineTo(*point)
        if line.closed:
            path.close()
        canvas.drawPath(path, stroke=1, fill=0)
    canvas.setStrokeGray(0)


def _draw_grid(canvas: Any, sheet: Sheet, shift: tuple[float, float]) -> None:
    """Draw crosses where lines of round coordinates meet, and name these at the edges."""
    step = grid_step(sheet.a_unit)
    lines = [
        _round_numbers(low + shift[k], low + shift[k] + length, step)
        for k, (low, length) in enumerate(((sheet.left, sheet.width), (sheet.bottom, sheet.height)))
    ]
    left, bottom = sheet.origin
    right, top = left + sheet.width * sheet.a_unit, bottom + sheet.height * sheet.a_unit
    canvas.setFont("Helvetica", _SMALL)
    canvas.setFillGray(0)
    digits = max(0, -math.floor(math.log10(step)))
    for value in lines[0]:
        x, _ = sheet.on_paper(value - shift[0], sheet.bottom)
        for y, outwards in ((bottom, -1), (top, 1)):
            canvas.line(x, y, x, y + outwards * _TICK)
        canvas.drawCentredString(x, bottom - _TICK - _SMALL, f"{value:.{digits}f}")
    for value in lines[1]:
        _, y = sheet.on_paper(sheet.left, value - shift[1])
        for x, outwards in ((left, -1), (right, 1)):
            canvas.line(x, y, x + outwards * _TICK, y)
        canvas.saveState()
        canvas.translate(left - _TICK - 0.6, y)
        canvas.rotate(90)
        canvas.drawCentredString(0, 0, f"{value:.{digits}f}")
        canvas.restoreState()
    canvas.setStrokeGray(0.35)
    for across in lines[0]:
        for up in lines[1]:
            x, y = sheet.on_paper(across - shift[0], up - shift[1])
            canvas.line(max(x - _CROSS, left), y, min(x + _CROSS, right), y)
            canvas.line(x, max(y - _CROSS, bottom), x, min(y + _CROSS, top))
    canvas.setStrokeGray(0)


def _round_numbers(low: float, high: float, step: float) -> list[float]:
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _draw_block(canvas: Any, content: SheetContent, sheet: Sheet, text: SheetText) -> None:
    width = sheet.size[0] - 2 * MARGIN
    canvas.rect(MARGIN, MARGIN, width, BLOCK - 4)
    middle = MARGIN + width / 2
    canvas.line(middle, MARGIN, middle, MARGIN + BLOCK - 4)
    top = MARGIN + BLOCK - 4
    canvas.setFont("Helvetica-Bold", _LARGE)
    canvas.drawString(MARGIN + 3, top - _LARGE - 1.5, _plain(f"{text.name}: {content.heading}")[:60])
    canvas.setFont("Helvetica", _TEXT)
    part = [f"sheet {sheet.part} of {sheet.parts}, row by row from the top left"] if sheet.parts > 1 else []
    notes = [*part, *text.notes]
    title = [f"{name}: {value}" for name, value in text.title.items()]
    _draw_columns(canvas, title, notes, (MARGIN + 3, top - _LARGE - 3, width / 2 - 6))
    _draw_arrow(canvas, MARGIN + width - 9, MARGIN + 5, text.arrow)
    if text.scale is None:
        canvas.setFillColorRGB(0.7, 0, 0)
        canvas.setFont("Helvetica-Bold", 3.6)
        canvas.drawString(middle + 4, top - 8, _NOT_METRIC)
        canvas.setFillGray(0)
    else:
        canvas.setFont("Helvetica-Bold", _LARGE)
        canvas.drawString(middle + 4, top - _LARGE - 1.5, f"1:{text.scale} on {sheet.paper}")
        _draw_bar(canvas, middle + 4, top - 14, sheet)
    if content.legend:
        _draw_legend(canvas, middle + 4, MARGIN + 4, content)


def _draw_columns(
    canvas: Any, title: Sequence[str], notes: Sequence[str], place: tuple[float, float, float]
) -> None:
    """Draw the lines of the title, and beside them the notes, from left and top `place` on, as wide as it says."""
    left, top, width = place
    first = width * 0.45 if title else 0.0
    shown = (
        title if len(title) <= _LINES else [*title[: _LINES - 1], f"and {len(title) - _LINES + 1} more lines"]
    )
    for column, lines, room in ((left, shown, first - 3), (left + first, notes, width - first)):
        for number, line in enumerate(lines[:_LINES]):
            canvas.drawString(column, top - (number + 1) * 3.6, _fitted(canvas, _plain(line), room))


def _fitted(canvas: Any, text: str, width: float) -> str:
    while canvas.stringWidth(text, "Helvetica", _TEXT) > width and len(text) > 4:
        text = text[:-4] + "..."
    return text


def _draw_bar(canvas: Any, x: float, y: float, sheet: Sheet) -> None:
    """Draw a scale bar in five parts, black and white by turns, within a frame as long as the bar."""
    length = bar_length(sheet)
    part = length * sheet.a_unit / 5
    for number in range(0, 5, 2):
        canvas.rect(x + number * part, y, part, 2, stroke=0, fill=1)
    canvas.rect(x, y, 5 * part, 2)
    canvas.setFont("Helvetica", _SMALL)
    for number in (0, 1, 5):
        canvas.drawCentredString(x + number * part, y - _SMALL - 0.8, f"{number * length / 5:g}")
    canvas.drawString(x + 5 * part + 3, y, "m")


def _draw_arrow(canvas: Any, x: float, y: float, words: str) -> None:
    canvas.line(x, y + 2, x, y + 16)
    head = canvas.beginPath()
    head.moveTo(x, y + 19)
    head.lineTo(x - 2, y + 13)
    head.lineTo(x + 2, y + 13)
    head.close()
    canvas.drawPath(head, stroke=0, fill=1)
    canvas.setFont("Helvetica", _SMALL)
    canvas.drawCentredString(x, y - 1.5, words)


def _draw_legend(canvas: Any, x: float, y: float, content: SheetContent) -> None:
    """Draw the colours of a map as a strip, with the deviations that they stand for."""
    width, steps = 70.0, 60
    stops = content.legend
    for number in range(steps):
        place = (number + 0.5) / steps * (len(stops) - 1)
        low = min(int(place), len(stops) - 2)
        share = place - low
        mixed = [a + (b - a) * share for a, b in zip(stops[low][1], stops[low + 1][1], strict=True)]
        canvas.setFillColorRGB(*(c / 255 for c in mixed))
        canvas.rect(x + number * width / steps, y + 3, width / steps + 0.05, 3, stroke=0, fill=1)
    canvas.setFillGray(0)
    canvas.rect(x, y + 3, width, 3)
    canvas.setFont("Helvetica", _SMALL)
    for number, (value, _) in enumerate(stops):
        label = f"{value:+g}" if value else "0"
        canvas.drawCentredString(x + number * width / (len(stops) - 1), y, label)
    canvas.drawString(x + width + 4, y, content.unit)
