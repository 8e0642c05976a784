"""Photographs for tests of commands."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest


@pytest.fixture
def photos(small_demo: Path, tmp_path: Path) -> Path:
    """Three JPEGs, one in a subfolder with a name of its own kind."""
    folder = tmp_path / "photos"
    (folder / "côté nord").mkdir(parents=True)
    for number, name in enumerate(["a.jpg", "b.jpg", "côté nord/c d.jpg"], 1):
        shutil.copy2(small_demo / f"images/portico_{number:02}.jpg", folder / name)
    return folder
