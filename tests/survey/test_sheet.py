"""Sheets of targets, read back from the PDF as a camera would see them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pypdfium2
import pytest

from colmap_ihe.errors import CapabilityError, OptionError
from colmap_ihe.survey import sheet_layout as layout
from colmap_ihe.survey.sheet import write_sheet
from colmap_ihe.survey.targets import find_targets

DPI = 200


def pages_of(file: Path) -> list[npt.NDArray[np.uint8]]:
    """Grey pictures of all pages at 200 dots an inch."""
    with pypdfium2.PdfDocument(file) as document:
        return [np.array(page.render(scale=DPI / 72).to_pil().convert("L")) for page in document]


def sizes_mm(file: Path) -> npt.NDArray[np.float64]:
    """(N, 2): width and height of everything that the first page draws, as the PDF has it."""
    with pypdfium2.PdfDocument(file) as document:
        bounds = np.array([drawn.get_bounds() for drawn in document[0].get_objects()])
    return np.asarray((bounds[:, 2:] - bounds[:, :2]) * 25.4 / 72)


@pytest.mark.parametrize(("size_mm", "dictionary"), [(60.0, "APRILTAG_36h11"), (35.0, "4X4_50")])
def test_every_target_is_on_the_sheets_at_its_true_size(
    tmp_path: Path, size_mm: float, dictionary: str
) -> None:
    file = tmp_path / "targets.pdf"
    count = write_sheet(file, size_mm, 14, dictionary, first=3)
    pages = pages_of(file)
    assert len(pages) == count > 1
    found = [target for page in pages for target in find_targets(page, dictionary)]
    assert [target.name for target in found] == [f"T{number}" for number in range(3, 17)]
    sides = np.array([target.side_px for target in found]) / DPI * 25.4
    np.testing.assert_allclose(sides, size_mm, atol=1.2 * 25.4 / DPI)  # the picture has whole pixels
    squares = np.abs(sizes_mm(file) - size_mm).max(axis=1) < 0.001 * size_mm
    assert squares.sum() == len(find_targets(pages[0], dictionary))


def test_targets_are_where_the_layout_has_them(tmp_path: Path) -> None:
    write_sheet(tmp_path / "targets.pdf", 50, 6)
    page = pages_of(tmp_path / "targets.pdf")[0]
    centres = np.array([target.centre_px for target in find_targets(page)])
    places = layout.places(range(6), 50, 8)[0]
    expected = np.array([(place.left + 25, layout.PAGE_MM[1] - place.bottom - 25) for place in places])
    pixel_mm = np.array(layout.PAGE_MM) / page.shape[::-1]
    np.testing.assert_allclose(centres * pixel_mm, expected, atol=0.08)


def test_the_rulers_are_100_mm_long_both_ways(tmp_path: Path) -> None:
    write_sheet(tmp_path / "targets.pdf", 60, 1)
    page = pages_of(tmp_path / "targets.pdf")[0]
    (left, bottom), (side, _) = layout.RULERS_MM
    row = round((layout.PAGE_MM[1] - bottom) * DPI / 25.4)
    dark = np.flatnonzero(page[row - 2 : row + 2].min(axis=0) < 160)
    dark = dark[dark > (left - 1) * DPI / 25.4]
    assert (dark.max() - dark.min() + 1) / DPI * 25.4 == pytest.approx(100, abs=0.4)
    column = round(side * DPI / 25.4)
    dark = np.flatnonzero(page[:, column - 2 : column + 2].min(axis=1) < 160)
    assert (dark.max() - dark.min() + 1) / DPI * 25.4 == pytest.approx(100, abs=0.4)


def test_a_file_that_is_there_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "targets.pdf"
    file.write_bytes(b"mine")
    with pytest.raises(OptionError, match="is there already"):
        write_sheet(file, 60, 4)
    assert file.read_bytes() == b"mine"


def test_what_cannot_be_printed_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "targets.pdf"
    with pytest.raises(OptionError, match="targets of 150 mm cannot be printed on A4") as caught:
        write_sheet(file, 150, 1)
    assert caught.value.hint == "give a size from 5 to 120 mm"
    write_sheet(file, 120, 1)
    with pytest.raises(OptionError, match="targets 40 to 59 of 4X4_50: it has those from 0 to 49"):
        write_sheet(tmp_path / "other.pdf", 60, 20, "4X4_50", first=40)


def test_without_reportlab_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "reportlab.pdfgen.canvas", None)
    with pytest.raises(CapabilityError, match="reportlab") as caught:
        write_sheet(tmp_path / "targets.pdf", 60, 4)
    assert ".[survey]" in caught.value.hint
