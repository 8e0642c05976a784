"""GeoTIFF, and TIFF with a world file, read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import tifffile

from colmap_ihe.drawings import raster_files
from colmap_ihe.drawings.grid import BLOCK, PixelGrid
from colmap_ihe.drawings.raster_files import Georeference, colour_file, files_of, relief_file

GRID = PixelGrid(2.0, 7.5, 0.25, 700, 600)
PLACE = Georeference(GRID, (691_000.0, 5_334_000.0), "EPSG:25832")
RGBA = np.random.default_rng(0).integers(0, 255, (600, 700, 4), np.uint8)
RELIEF = np.random.default_rng(1).normal(0, 40, (600, 700)).astype(np.float32)
RELIEF[:9] = np.nan


def write(folder: Path) -> None:
    with colour_file(folder, "orthophoto", PLACE) as write_rows:
        write_rows(0, RGBA[:BLOCK])
        write_rows(BLOCK, RGBA[BLOCK:])
    with relief_file(folder, "relief", PLACE) as write_rows:
        write_rows(0, RELIEF)


def test_geotiff_holds_pixels_place_and_system(tmp_path: Path) -> None:
    write(tmp_path)
    with rasterio.open(tmp_path / "orthophoto.tif") as file:
        assert np.array_equal(np.moveaxis(file.read(), 0, 2), RGBA)
        assert file.crs.to_epsg() == 25832
        assert file.transform[:6] == (0.25, 0, 691_002, 0, -0.25, 5_334_007.5)
        assert file.colorinterp[3].name == "alpha" and file.profile["tiled"]
    with rasterio.open(tmp_path / "relief.tif") as file:
        assert np.array_equal(file.read(1), RELIEF, equal_nan=True) and np.isnan(file.nodata)
    assert np.array_equal(tifffile.imread(tmp_path / "relief.tif"), RELIEF, equal_nan=True)


def test_without_rasterio_there_is_a_world_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raster_files, "has_rasterio", lambda: False)
    write(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(
        [*files_of("orthophoto"), *files_of("relief")]
    )
    assert np.array_equal(tifffile.imread(tmp_path / "orthophoto.tif"), RGBA)
    assert np.array_equal(tifffile.imread(tmp_path / "relief.tif"), RELIEF, equal_nan=True)
    values = list(map(float, (tmp_path / "relief.tfw").read_text().split()))
    assert values == [0.25, 0, 0, -0.25, 691_002.125, 5_334_007.375]
    with rasterio.open(tmp_path / "relief.tif") as file:  # which GDAL reads
        assert file.transform[:6] == (0.25, 0, 691_002, 0, -0.25, 5_334_007.5)
