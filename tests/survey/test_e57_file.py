"""A cloud as E57 has the true coordinates, colours and coordinate system, and is whole or not there."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
import pye57
import pyproj
import pytest
from cloud_rows import OFFSET, UTM, cloud, model_points

from colmap_ihe.errors import Cancelled, DiskFullError, ProjectError
from colmap_ihe.machine.progress import Silent
from colmap_ihe.survey import cloud_system, e57_file
from colmap_ihe.survey.e57_file import missing_for_e57, write_e57
from colmap_ihe.survey.frames import GPS, Frame


def points_in(path: Path) -> npt.NDArray[np.float64]:
    """(N, 3): coordinates in a file, as a reader of scans takes them."""
    with pye57.E57(str(path)) as file:
        scan = file.read_scan(0, ignore_missing_fields=True)
    return np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1)


def test_coordinates_at_utm_offsets_are_true_to_a_tenth_of_a_millimetre(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cloud_system, "CHUNK", 1000)
    rows = cloud(2500)
    write_e57(tmp_path / "fused.e57", rows, UTM)
    np.testing.assert_allclose(
        points_in(tmp_path / "fused.e57"), model_points(rows) + OFFSET, rtol=0, atol=0.5001e-4
    )
    with pye57.E57(str(tmp_path / "fused.e57")) as file:
        scan = file.read_scan_raw(0)
        crs, header = pyproj.CRS(file.root["coordinateMetadata"].value()), file.get_header(0)
        assert (file.scan_count, header.point_count, header.has_pose()) == (1, 2500, False)
        assert (header.xMinimum, header.zMaximum) == pytest.approx(
            (scan["cartesianX"].min(), scan["cartesianZ"].max())
        )
    for field, name in (("colorRed", "red"), ("colorGreen", "green"), ("colorBlue", "blue")):
        assert np.array_equal(scan[field], rows[name])
    assert crs.to_epsg() == 25832
    assert [path.name for path in tmp_path.iterdir()] == ["fused.e57"]


def test_the_same_cloud_gives_the_same_bytes_and_another_one_another_guid(tmp_path: Path) -> None:
    rows = cloud(50)
    for name in ("a", "b"):
        write_e57(tmp_path / f"{name}.e57", rows, Frame())
    rows["blue"][7] ^= 1
    write_e57(tmp_path / "c.e57", rows, Frame())
    contents = [(tmp_path / f"{name}.e57").read_bytes() for name in "abc"]
    assert contents[0] == contents[1]
    guids = []
    for name in "ac":
        with pye57.E57(str(tmp_path / f"{name}.e57")) as file:
            guids += [file.root["guid"].value(), file.get_header(0)["guid"].value()]
    assert len(set(guids)) == 4


def test_a_frame_of_degrees_is_written_in_utm_of_its_zone(tmp_path: Path) -> None:
    rows = cloud(1)
    rows["x"] = rows["y"] = rows["z"] = 0
    write_e57(tmp_path / "a.e57", rows, Frame(GPS, origin=(-33.45, -70.66, 567.0)))
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32719", always_xy=True)
    expected = [*to_utm.transform(-70.66, -33.45), 567.0]
    np.testing.assert_allclose(points_in(tmp_path / "a.e57"), [expected], rtol=0, atol=1e-4)


def test_stopped_half_way_nothing_is_left_and_the_old_file_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cloud_system, "CHUNK", 10)
    (tmp_path / "a.e57").write_text("old")

    class StoppedInTheMiddle(Silent):
        done = 0

        def start(self, total: int, unit: str = "images") -> None:
            self.done = 0 if unit == e57_file.UNIT else -(10**6)

        def advance(self, count: int = 1) -> None:
            self.done += count
            if self.done >= 20:
                raise Cancelled

    with pytest.raises(Cancelled):
        write_e57(tmp_path / "a.e57", cloud(50), Frame(), StoppedInTheMiddle())
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.e57", "old")]


def test_a_full_disk_is_told_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10))
    with pytest.raises(DiskFullError):
        write_e57(tmp_path / "a.e57", cloud(5), Frame())


def test_what_the_library_cannot_write_is_told_with_the_file(tmp_path: Path) -> None:
    (tmp_path / ".a.e57.new").mkdir()
    with pytest.raises(ProjectError, match=r"a\.e57: cannot be written as E57 \(open\(\) failed"):
        write_e57(tmp_path / "a.e57", cloud(5), Frame())


def test_what_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_for_e57(UTM) == []
    for name in ("pye57", "pyproj"):
        monkeypatch.setitem(sys.modules, name, None)
    assert missing_for_e57(Frame()) == ["pye57"]
    assert missing_for_e57(UTM) == ["pye57", "pyproj"]
