"""What a project is expected to need before it runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from colmap_ihe.batch import preview
from colmap_ihe.batch.preview import preview_project


def test_memory_grows_with_pixels_and_falls_with_options(small_demo: Path) -> None:
    def memory(*assignments: str) -> int:
        return preview_project(small_demo, assignments).memory_bytes

    assert memory() > memory("dense.enabled=false") > 600_000_000
    assert memory("dense.max_image_size=100") < memory()


def test_what_is_wrong_with_a_project_is_in_its_preview(
    tmp_path: Path, small_demo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "no such folder of photographs" in preview_project(tmp_path, []).reason

    def broken(*_: object) -> None:
        raise TypeError("odd")

    monkeypatch.setattr(preview, "find_photographs", broken)
    assert "TypeError: odd" in preview_project(small_demo, []).reason
