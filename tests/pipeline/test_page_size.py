"""A page keeps to the size that it may have."""

from __future__ import annotations

import dataclasses

import pytest
from synthetic import facade_surface, synthetic_contents

from colmap_ihe.pipeline.page_size import page_within

CONTENTS = dataclasses.replace(synthetic_contents(120_000, 4), surface=facade_surface(150))


def test_with_room_all_is_shown() -> None:
    page = page_within(CONTENTS, 25, pytest.fail).decode()
    assert "60,000 triangles" in page
    assert '"picture":"data:' in page


@pytest.mark.parametrize("max_mb", [3.5, 3.0, 2.6])
def test_with_less_room_less_is_shown_and_the_page_says_how_much(max_mb: float) -> None:
    whole = page_within(CONTENTS, 25, pytest.fail)
    page = page_within(CONTENTS, max_mb, pytest.fail)
    assert len(page) <= max_mb * 1e6 < len(whole)
    assert '"picture":"data:' not in page.decode()


def test_a_page_that_is_still_too_large_is_written_with_a_warning() -> None:
    warnings: list[str] = []
    page = page_within(CONTENTS, 1, warnings.append)
    assert len(page) > 1e6 and 'id="surface"' not in page.decode()
    assert len(warnings) == 1 and "more than report.max_mb, 1" in warnings[0]
