"""Sheets, read back by another program: pages, scale bar, words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pypdfium2
import pypdfium2.raw as pdfium
import pytest
import simplejpeg

from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.lines import Layer, Line
from colmap_ihe.drawings.sheet import SheetContent, SheetText, write_sheets

MM = 25.4 / 72
GRID = PixelGrid(-6.0, 5.0, 0.01, 1200, 500)
LAYER = Layer("SECTION", [Line(np.array([(-6.0, 0.0), (6.0, 0.0)]))], (190, 30, 45), 0.1)


def text_of(scale: int | None) -> SheetText:
    return SheetText(
        {"object": "Portico", "author": "Å. Ünal"}, "front", ["pixels of 10 mm"], scale, (0, 0), "plumb"
    )


def jpeg() -> bytes:
    picture = np.full((500, 1200, 3), 60, np.uint8)
    return bytes(simplejpeg.encode_jpeg(picture, quality=90))


def boxes(page: pypdfium2.PdfPage, kind: int) -> list[tuple[float, float, float, float]]:
    """Left, bottom, right and top of what a page holds, in millimetres of paper."""
    bounds = [item.get_bounds() for item in page.get_objects(filter=(kind,), max_depth=3)]
    return [(MM * a, MM * b, MM * c, MM * d) for a, b, c, d in bounds]


@pytest.mark.parametrize("scale", [20, 50, 100])
def test_a_sheet_measures_right(tmp_path: Path, scale: int) -> None:
    """Its picture of 12 by 5 m, and the scale bar, which is the row of black bars with whole metres on it."""
    papers = write_sheets(
        tmp_path / "a.pdf", [SheetContent("orthophoto", [LAYER], jpeg(), GRID)], (-6, 0, 6, 5), text_of(scale)
    )
    page = pypdfium2.PdfDocument(tmp_path / "a.pdf")[0]
    assert papers == [{20: "A1", 50: "A4", 100: "A4"}[scale]]
    ((left, bottom, right, top),) = boxes(page, pdfium.FPDF_PAGEOBJ_IMAGE)
    assert right - left == pytest.approx(12_000 / scale, rel=1e-3)
    assert top - bottom == pytest.approx(5_000 / scale, rel=1e-3)
    length = {20: 2.0, 50: 5.0, 100: 10.0}[scale]
    paths = boxes(page, pdfium.FPDF_PAGEOBJ_PATH)
    bars = [
        (a, c)
        for a, b, c, d in paths
        if abs(d - b - 2) < 1e-3 and abs(c - a - 1000 * length / scale / 5) < 0.2
    ]
    assert len(bars) == 3  # the black fifths: the first, the third and the last
    assert max(c for _, c in bars) - min(a for a, _ in bars) == pytest.approx(1000 * length / scale, rel=1e-3)
    words = page.get_textpage().get_text_range()
    assert f"1:{scale} on {papers[0]}" in words and "object: Portico" in words and "Å. Ünal" in words
    assert "plumb" in words and "pixels of 10 mm" in words


def test_lines_lie_on_the_picture(tmp_path: Path) -> None:
    write_sheets(tmp_path / "a.pdf", [SheetContent("x", [LAYER], jpeg(), GRID)], (-6, 0, 6, 5), text_of(50))
    page = pypdfium2.PdfDocument(tmp_path / "a.pdf")[0]
    ((left, bottom, right, _),) = boxes(page, pdfium.FPDF_PAGEOBJ_IMAGE)
    lines = boxes(page, pdfium.FPDF_PAGEOBJ_PATH)
    assert any(
        abs(a - left) < 0.3 and abs(c - right) < 0.3 and abs((b + d) / 2 - bottom) < 0.1
        for a, b, c, d in lines
    )


def test_of_a_model_without_scale_it_says_so_and_gives_none(tmp_path: Path) -> None:
    content = [SheetContent("orthophoto", (), jpeg(), GRID), SheetContent("section", [LAYER])]
    assert write_sheets(tmp_path / "a.pdf", content, (-6, 0, 6, 5), text_of(None)) == ["A3", "A3"]
    document = pypdfium2.PdfDocument(tmp_path / "a.pdf")
    for page in document:
        words = page.get_textpage().get_text_range()
        assert "NOT TO SCALE: the model is not metric" in words and "1:" not in words
        assert not [b for b in boxes(page, pdfium.FPDF_PAGEOBJ_PATH) if abs(b[3] - b[1] - 2) < 1e-3]


def test_a_drawing_of_many_sheets_has_its_parts_at_scale(tmp_path: Path) -> None:
    papers = write_sheets(
        tmp_path / "a.pdf", [SheetContent("x", (), jpeg(), GRID)], (-6, 0, 6, 5), text_of(10)
    )
    document = pypdfium2.PdfDocument(tmp_path / "a.pdf")
    assert papers == ["A1", "A1"] and len(document) == 2
    assert "sheet 2 of 2" in document[1].get_textpage().get_text_range()
    ((left, _, right, _),) = boxes(document[0], pdfium.FPDF_PAGEOBJ_IMAGE)
    assert right - left <= 1200 * 1.001
