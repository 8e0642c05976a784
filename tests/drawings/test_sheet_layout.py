"""How drawings are laid out on paper."""

from __future__ import annotations

import pytest

from colmap_ihe.drawings.sheet_layout import bar_length, field_of, grid_step, sheets_for


@pytest.mark.parametrize(
    ("width", "height", "scale", "paper", "landscape"),
    [
        (5.0, 9.0, 50, "A4", False),
        (12.0, 5.0, 50, "A4", True),
        (15.0, 8.0, 50, "A3", True),
        (30.0, 20.0, 50, "A1", True),
    ],
)
def test_a_drawing_takes_the_smallest_paper(
    width: float, height: float, scale: int, paper: str, landscape: bool
) -> None:
    (sheet,) = sheets_for(-1, 2, width - 1, height + 2, scale)
    assert (sheet.paper, sheet.size[0] > sheet.size[1], sheet.parts) == (paper, landscape, 1)
    assert sheet.on_paper(width - 1, 2)[0] - sheet.on_paper(-1, 2)[0] == pytest.approx(1000 * width / scale)


def test_what_no_paper_holds_takes_several() -> None:
    sheets = list(sheets_for(0, 0, 60, 20, 50))  # 1.2 m wide
    assert [(sheet.part, sheet.parts, sheet.paper) for sheet in sheets] == [(1, 2, "A1"), (2, 2, "A1")]
    first, second = sheets
    assert first.left + first.width == pytest.approx(second.left)
    assert first.bottom + first.height == pytest.approx(20)
    assert first.width * first.a_unit == pytest.approx(field_of(first.size)[2])
    assert second.left + second.width > 60


def test_without_a_scale_it_fills_one_sheet() -> None:
    (sheet,) = sheets_for(0, 0, 800, 3, None)
    assert sheet.width * sheet.a_unit == pytest.approx(field_of(sheet.size)[2])


def test_bars_and_grids_are_round_and_have_room() -> None:
    (small,), (large,) = sheets_for(0, 0, 5, 9, 50), sheets_for(0, 0, 15, 8, 50)
    assert (bar_length(small), bar_length(large)) == (2.5, 5)
    assert [grid_step(1000 / scale) for scale in (20, 50, 100, 500)] == [1, 2, 5, 20]
