"""A cloud as LAZ: coordinates of a map to a tenth of a millimetre."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from colmap_ihe.survey import cloud_file
from colmap_ihe.survey.cloud_file import missing_libraries, write_laz
from colmap_ihe.survey.frames import GPS, frame_of

PLY = np.dtype([*((n, "<f4") for n in "xyz"), *((n, "u1") for n in ("red", "green", "blue"))])


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    monkeypatch.setattr(cloud_file, "_CHUNK", 30)
    draw = np.random.default_rng(0)
    rows = np.zeros(100, PLY)
    for name in "xyz":
        rows[name] = draw.uniform(-20, 20, 100)
    rows["red"] = np.arange(100)
    return rows


def places(file: Path) -> np.ndarray:
    read = laspy.read(file)
    return np.stack([np.asarray(read.x), np.asarray(read.y), np.asarray(read.z)], axis=1)


def test_map_coordinates_are_true_to_a_tenth_of_a_millimetre(rows: np.ndarray, tmp_path: Path) -> None:
    assert missing_libraries() == []
    frame = frame_of("EPSG:25832", [(691_234.5, 5_334_765.25, 512.3)])
    write_laz(tmp_path / "a.laz", rows, frame)
    read = laspy.read(tmp_path / "a.laz")
    true = np.stack([rows[n].astype(float) for n in "xyz"], axis=1) + np.array((691_200, 5_334_800, 0))
    assert np.abs(places(tmp_path / "a.laz") - true).max() <= 0.00005 + 1e-8
    assert read.header.parse_crs().to_epsg() == 25832
    assert read.red[99] == 99 * 257
    assert [file.name for file in tmp_path.iterdir()] == ["a.laz"]


def test_degrees_are_written_in_utm_and_a_local_system_without_one(rows: np.ndarray, tmp_path: Path) -> None:
    frame = frame_of(GPS, [(9.0, 48.0, 500.0)])  # on the middle meridian of zone 32
    write_laz(tmp_path / "a.laz", rows, frame)
    assert laspy.read(tmp_path / "a.laz").header.parse_crs().to_epsg() == 32632
    east = places(tmp_path / "a.laz")[:, 0] - 500_000
    np.testing.assert_allclose(east, rows["x"] * 0.9996, atol=2e-3)
    write_laz(tmp_path / "b.laz", rows, frame_of("", []))
    assert laspy.read(tmp_path / "b.laz").header.parse_crs() is None
    np.testing.assert_allclose(places(tmp_path / "b.laz")[:, 2], rows["z"], atol=6e-5)
