"""How memory is shared out to the projects of a batch, and what remains of them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from colmap_ihe.batch.entry import Entry, remaining_of, share_of
from colmap_ihe.batch.preview import ProjectPreview
from colmap_ihe.pipeline.job import StageProgress

GB = 10**9


def entry(need: int = 0, **more: Any) -> Entry:
    return Entry(Path("p"), preview=ProjectPreview(10, 8 * 10**6, need), **more)


def test_as_many_at_a_time_as_memory_has_room_for() -> None:
    held = entry(4 * GB, progress=StageProgress(bytes=GB))
    assert share_of(entry(2 * GB), [], 10 * GB) == 2 * GB
    assert share_of(entry(2 * GB), [held], 6 * GB) == 2 * GB  # 3 GB are still to be taken
    assert share_of(entry(4 * GB), [held], 6 * GB) is None
    assert share_of(entry(20 * GB), [], 6 * GB) == 6 * GB  # alone it may try with what there is
    assert share_of(entry(GB, alone=True), [held], 60 * GB) is None
    assert share_of(entry(GB), [entry(GB, alone=True)], 60 * GB) is None
    assert share_of(entry(GB, alone=True), [], 60 * GB) == 60 * GB
    assert share_of(entry(GB), [held], 0) == 0  # the system does not say


def test_remaining_time_is_by_megapixels() -> None:
    running = entry(state="running", began_s=time.monotonic() - 30)
    assert remaining_of([running, entry()], 10) == pytest.approx(70 + 100, abs=1)
    assert remaining_of([running, running, entry()], 10) == pytest.approx((70 + 70 + 100) / 2, abs=1)
    assert remaining_of([entry(), Entry(Path("q"))], 10) is None
    assert remaining_of([entry(state="done")], 10) is None
