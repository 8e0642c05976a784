"""PatchMatch's maps are where fusion looks for them, on disks without links too."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.backend import patchmatch_depth_maps

MAPS = ("depth_maps/nef/a.png.geometric.bin", "normal_maps/nef/a.png.geometric.bin")


@pytest.mark.parametrize("has_links", [True, False])
def test_maps_are_linked_or_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_links: bool) -> None:
    def stereo(workspace: Path, **_: Any) -> None:
        for name in MAPS:
            (workspace / "stereo" / name).parent.mkdir(parents=True, exist_ok=True)
            (workspace / "stereo" / name).write_text(name)

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")  # exFAT's

    monkeypatch.setattr(pycolmap, "patch_match_stereo", stereo)
    if not has_links:
        monkeypatch.setattr(os, "link", refuse)
    (tmp_path / "stereo/depth_maps/nef").mkdir(parents=True)
    (tmp_path / "stereo" / MAPS[0]).write_text("of an earlier run")
    patchmatch_depth_maps(tmp_path)
    for name in MAPS:
        assert (tmp_path / "stereo" / name).read_text() == name
        assert (tmp_path / "stereo" / name).stat().st_nlink == (2 if has_links else 1)
    assert len([p for p in (tmp_path / "stereo").rglob("*") if p.is_file()]) == 2
