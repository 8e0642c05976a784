"""The cloud of a metric model in the coordinates of its survey."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import laspy
import numpy as np
import pytest

from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.stages import dense
from colmap_ihe.pipeline.stages.dense import LAZ, DenseRecord

HEAD = """ply
format binary_little_endian 1.0
element vertex 2
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""


def run_of(folder: Path, crs: str) -> Any:
    rows = np.zeros(2, [*((n, "<f4") for n in "xyz"), *((n, "u1") for n in ("red", "green", "blue"))])
    rows["x"] = 1.25, -3.5
    (folder / "fused.ply").write_bytes(HEAD.encode() + rows.tobytes())
    frame = {"crs": crs, "offset": [691_200.0, 5_334_800.0, 0.0], "origin": None}
    return SimpleNamespace(project=SimpleNamespace(dense=folder), records={"survey": {"frame": frame}})


def record() -> DenseRecord:
    return DenseRecord(points=2, backend="sgm", pixels=1, pixels_with_depth=1)


def test_it_lies_beside_the_ply_in_map_coordinates(tmp_path: Path) -> None:
    made = record()
    dense._write_laz(run_of(tmp_path, "EPSG:25832"), made, SILENT)
    assert made.laz
    np.testing.assert_allclose(np.asarray(laspy.read(tmp_path / LAZ).x), (691_201.25, 691_196.5), atol=1e-4)
    project: Any = SimpleNamespace(dense=tmp_path)
    assert [f.name for f in dense.STAGE.files(project, made.model_dump())] == ["fused.ply", LAZ]


@pytest.mark.parametrize(("crs", "told"), [("EPSG:25832", 1), ("", 0)])
def test_without_its_libraries_it_is_told_where_coordinates_have_a_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, crs: str, told: int
) -> None:
    monkeypatch.setattr("colmap_ihe.survey.cloud_file._NEEDED", ("laspy", "no_such_library"))
    made = record()
    dense._write_laz(run_of(tmp_path, crs), made, SILENT)
    assert (made.laz, len(made.warnings), (tmp_path / LAZ).exists()) == (False, told, False)
    assert all("no_such_library not installed" in text for text in made.warnings)
