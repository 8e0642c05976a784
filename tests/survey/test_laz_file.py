"""A cloud as LAZ has the true coordinates, colours and coordinate system."""

from __future__ import annotations

import sys
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
from cloud_rows import UTM, cloud, model_points

from colmap_ihe.survey import cloud_system
from colmap_ihe.survey.frames import GPS, Frame
from colmap_ihe.survey.laz_file import missing_for_laz, write_laz


def test_coordinates_at_utm_offsets_are_true_to_a_tenth_of_a_millimetre(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cloud_system, "CHUNK", 1000)
    rows = cloud()
    write_laz(tmp_path / "fused.laz", rows, UTM)
    las = laspy.read(tmp_path / "fused.laz")
    expected = model_points(rows) + np.array([691_000.0, 5_334_100.0, 0.0])
    np.testing.assert_allclose(las.xyz, expected, rtol=0, atol=0.5001e-4)
    assert las.header.scales.tolist() == [0.0001] * 3
    assert las.header.offsets.tolist() == [691_000.0, 5_334_100.0, 0.0]
    assert las.header.parse_crs().to_epsg() == 25832
    assert las.header.are_points_compressed
    assert las.header.global_encoding.wkt
    assert las.header.vlrs[0].string.startswith('PROJCS["ETRS89 / UTM zone 32N"')
    for name in ("red", "green", "blue"):
        assert np.array_equal(las[name], rows[name] * np.uint16(257))
    assert [path.name for path in tmp_path.iterdir()] == ["fused.laz"]


def test_a_frame_of_degrees_is_written_in_utm_of_its_zone(tmp_path: Path) -> None:
    rows = cloud(3)
    rows["x"], rows["y"], rows["z"] = [0, 30, 0], [0, 0, 40], [0, 1, 2]
    write_laz(tmp_path / "a.laz", rows, Frame(GPS, origin=(-33.45, -70.66, 567.0)))
    las = laspy.read(tmp_path / "a.laz")
    assert las.header.parse_crs().to_epsg() == 32719
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32719", always_xy=True)
    x, y = to_utm.transform(-70.66, -33.45)
    np.testing.assert_allclose(las.xyz[0], [x, y, 567.0], rtol=0, atol=1e-4)
    across = np.linalg.norm(las.xyz[1:, :2] - las.xyz[0, :2], axis=1)
    factors = pyproj.Proj("EPSG:32719").get_factors(-70.66, -33.45)
    np.testing.assert_allclose(
        across, [30 * factors.parallel_scale, 40 * factors.meridional_scale], atol=5e-3
    )


def test_a_local_system_has_no_crs_and_points_far_away_a_larger_step(tmp_path: Path) -> None:
    rows = cloud(2)
    rows["x"] = [0, 900_000]
    write_laz(tmp_path / "a.laz", rows, Frame())
    las = laspy.read(tmp_path / "a.laz")
    assert las.header.parse_crs() is None
    assert las.header.scales[0] == pytest.approx(0.001)
    np.testing.assert_allclose(las.x, [0, 900_000], atol=0.0006)


def test_what_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_for_laz(UTM) == []
    for name in ("lazrs", "pyproj"):
        monkeypatch.setitem(sys.modules, name, None)
    assert missing_for_laz(Frame()) == ["lazrs"]
    assert missing_for_laz(UTM) == ["lazrs", "pyproj"]
