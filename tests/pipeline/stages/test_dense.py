"""The stage leaves the cloud as LAZ and E57 too where the model is in metres."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pye57
import pyproj
import pytest

from colmap_ihe.dense.ply import write_rows
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline.stage import RunContext
from colmap_ihe.pipeline.stages import dense
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

FRAME = {"crs": "EPSG:25832", "offset": [691_000.0, 5_334_100.0, 0.0], "origin": None}
METRIC = {"survey": {"method": "control", "frame": FRAME}, "convert": {"grey": {}}}
KINDS = [*((axis, "<f4") for axis in "xyz"), *((name, "u1") for name in ("red", "green", "blue"))]


def stage_record(
    root: Path, records: dict[str, Any], monkeypatch: pytest.MonkeyPatch, points: int = 2
) -> dict[str, Any]:
    """Run the stage, with a cloud of at most two points in place of stereo."""
    (root / "images").mkdir(parents=True)
    project = Project.at(root)
    project.dense.mkdir(parents=True)

    def cloud(*_: object) -> dict[str, Any]:
        rows = np.array([(0, 0, 0, 1, 2, 3), (1, 2, 3, 255, 0, 0)], KINDS)
        write_rows(project.dense / "fused.ply", rows[:points])
        return {"points": points, "backend": "sgm", "pixels": 9, "pixels_with_depth": 2, "warnings": []}

    monkeypatch.setattr(dense, "dense_cloud", cloud)
    monkeypatch.setattr(dense, "second_of", lambda _: None)
    with local_executor() as executor:
        run = RunContext(project, Options(), Discovery((), ()), executor, records=records)
        record = dense.run(run, SILENT).model_dump(exclude_unset=True)
    names = [path.name for path in dense.STAGE.files(project, record)]
    assert sorted(names) == sorted(path.name for path in project.dense.iterdir())
    return record


def test_a_cloud_in_metres_is_written_as_laz_in_its_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert stage_record(tmp_path / "a", METRIC, monkeypatch)["laz"]
    las = laspy.read(tmp_path / "a" / "workspace" / "dense" / "0" / "fused.laz")
    np.testing.assert_allclose(las.xyz, [[691_000, 5_334_100, 0], [691_001, 5_334_102, 3]], rtol=0, atol=1e-6)


def test_a_cloud_in_metres_is_written_as_e57_in_its_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert stage_record(tmp_path / "a", METRIC, monkeypatch)["e57"]
    with pye57.E57(str(tmp_path / "a" / "workspace" / "dense" / "0" / "fused.e57")) as file:
        scan = file.read_scan_raw(0)
        assert pyproj.CRS(file.root["coordinateMetadata"].value()).to_epsg() == 25832
    np.testing.assert_allclose(scan["cartesianY"], [5_334_100, 5_334_102], rtol=0, atol=1e-6)


def test_a_cloud_without_scale_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not {"laz", "e57"} & stage_record(tmp_path / "a", {"convert": {"grey": {}}}, monkeypatch).keys()


@pytest.mark.parametrize(
    ("key", "kind", "package", "other"), [("laz", "LAZ", "laspy", "e57"), ("e57", "E57", "pye57", "laz")]
)
def test_without_its_package_a_warning_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, kind: str, package: str, other: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    record = stage_record(tmp_path / "a", METRIC, monkeypatch)
    assert key not in record
    assert record[other]
    assert record["warnings"] == [
        f"the cloud is not written as {kind}, as {package} is not installed: pip install 'colmap-ihe[survey]', and run"
        " again with --from dense"
    ]


def test_of_a_local_system_the_ply_file_is_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "laspy", None)
    local = {"survey": {"method": "control", "frame": {**FRAME, "crs": ""}}, "convert": {"grey": {}}}
    assert stage_record(tmp_path / "a", local, monkeypatch)["warnings"] == []


def test_an_empty_cloud_is_written_as_ply_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = stage_record(tmp_path / "a", METRIC, monkeypatch, points=0)
    assert not {"laz", "e57"} & record.keys()
    assert record["warnings"] == []
