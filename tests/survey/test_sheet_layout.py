"""Where targets are on their sheets."""

from __future__ import annotations

from itertools import combinations

import pytest

from colmap_ihe.survey.sheet_layout import PAGE_MM, RULER_MM, RULERS_MM, Place, places


def overlap(one: Place, other: Place) -> bool:
    left, bottom, right, top = one.tile
    other_left, other_bottom, other_right, other_top = other.tile
    return left < other_right and other_left < right and bottom < other_top and other_bottom < top


@pytest.mark.parametrize(("size_mm", "cells"), [(5.0, 8), (33.3, 6), (60.0, 8), (120.0, 8)])
def test_targets_overlap_neither_each_other_nor_the_rulers(size_mm: float, cells: int) -> None:
    sheets = places(range(40), size_mm, cells)
    assert [place.number for sheet in sheets for place in sheet] == list(range(40))
    (across_x, across_y), (up_x, up_y) = RULERS_MM
    for sheet in sheets:
        assert not any(overlap(one, other) for one, other in combinations(sheet, 2))
        for place in sheet:
            left, bottom, right, top = place.tile
            assert left > up_x
            assert bottom > across_y + 4
            assert right < PAGE_MM[0] - 5
            assert top < PAGE_MM[1] - 5
            assert place.margin == pytest.approx(2 * size_mm / cells)
    assert across_x + RULER_MM < PAGE_MM[0]
    assert up_y + RULER_MM < PAGE_MM[1]


def test_a_sheet_holds_six_of_50_mm() -> None:
    assert [len(sheet) for sheet in places(range(13), 50.0, 8)] == [6, 6, 1]
