"""PLY files as COLMAP writes them on each system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.dense.ply import read_ply, write_rows
from colmap_ihe.errors import ProjectError

ROWS = np.array([(1.0, 2.0, 10), (13.0, 3.0, 13)], [("x", "<f4"), ("y", "<f4"), ("red", "u1")])


def test_a_header_whose_lines_end_as_on_windows(tmp_path: Path) -> None:
    write_rows(tmp_path / "cloud.ply", ROWS)
    header, end, body = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")
    (tmp_path / "windows.ply").write_bytes((header + end).replace(b"\n", b"\r\n") + body)
    assert (read_ply(tmp_path / "windows.ply")["vertex"] == ROWS).all()


def test_a_header_without_an_end_is_told(tmp_path: Path) -> None:
    (tmp_path / "cloud.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n")
    with pytest.raises(ProjectError, match="its header has no end"):
        read_ply(tmp_path / "cloud.ply")
