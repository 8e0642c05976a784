"""Write drawings of any size as TIFF, band by band: GeoTIFF by rasterio, else TIFF with a world file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tifffile

from colmap_ihe.drawings.grid import BLOCK, PixelGrid
from colmap_ihe.machine.files import write_bytes

_Rows = npt.NDArray[Any]
WriteRows = Callable[[int, _Rows], None]
"""Writes rows (H, W) or (H, W, 4) of a picture from a row on."""

_LARGE = 4_000_000  # pixels, from which on a file has smaller copies of itself, to be looked at
_COMPRESSION = {"compress": "deflate", "zlevel": 1}


@dataclass(frozen=True)
class Georeference:
    """Say where a picture lies: its grid, what is added to across and up so that they are the user's coordinates, and
    the system of those as PROJ knows it, empty for none."""

    grid: PixelGrid
    shift: tuple[float, float]
    crs: str = ""

    @property
    def corner(self) -> tuple[float, float]:
        """Return the outer corner of the first pixel in the user's coordinates."""
        return self.grid.left + self.shift[0], self.grid.top + self.shift[1]


def has_rasterio() -> bool:
    """Tell whether files are GeoTIFF."""
    try:
        import_module("rasterio")
    except ImportError:
        return False
    return True


def files_of(name: str) -> list[str]:
    """Return the names of the files that a picture becomes."""
    return [f"{name}.tif"] if has_rasterio() else [f"{name}.tif", f"{name}.tfw"]


@contextmanager
def colour_file(folder: Path, name: str, place: Georeference) -> Iterator[WriteRows]:
    """Give what writes rows (H, W, 4) uint8 RGBA into folder/name.tif."""
    with _opened(folder, name, place, np.dtype(np.uint8), 4) as write:
        yield write


@contextmanager
def relief_file(folder: Path, name: str, place: Georeference) -> Iterator[WriteRows]:
    """Give what writes rows (H, W) float32, nan where there is nothing, into folder/name.tif."""
    with _opened(folder, name, place, np.dtype(np.float32), 1) as write:
        yield write


@contextmanager
def _opened(
    folder: Path, name: str, place: Georeference, dtype: np.dtype[Any], channels: int
) -> Iterator[WriteRows]:
    opened = _with_rasterio if has_rasterio() else _with_tifffile
    with opened(folder / f"{name}.tif", place, dtype, channels) as write:
        yield write


@contextmanager
def _with_rasterio(
    path: Path, place: Georeference, dtype: np.dtype[Any], channels: int
) -> Iterator[WriteRows]:
    import rasterio
    from rasterio.windows import Window

    grid = place.grid
    x, y = place.corner
    colour = {"photometric": "RGB", "alpha": "NON-PREMULTIPLIED", "predictor": 2}
    profile: dict[str, Any] = {
        "driver": "GTiff",
        "width": grid.width,
        "height": grid.height,
        "count": channels,
        "dtype": dtype.name,
        "transform": rasterio.Affine(grid.pixel, 0.0, x, 0.0, -grid.pixel, y),
        "BIGTIFF": "IF_SAFER",
        **_COMPRESSION,
        **(colour if channels > 1 else {"nodata": float("nan")}),
    }
    if place.crs:
        profile["crs"] = place.crs
    if min(grid.width, grid.height) >= BLOCK:
        profile |= {"tiled": True, "blockxsize": BLOCK, "blockysize": BLOCK}
    with rasterio.open(path, "w", **profile) as file:

        def write(row: int, rows: _Rows) -> None:
            planes = np.moveaxis(rows, 2, 0) if rows.ndim == 3 else rows[None]
            file.write(planes, window=Window(0, row, grid.width, len(rows)))

        yield write
    if grid.width * grid.height > _LARGE:
        with rasterio.open(path, "r+") as file:
            file.build_overviews([2, 4, 8, 16], rasterio.enums.Resampling.average)


@contextmanager
def _with_tifffile(
    path: Path, place: Georeference, dtype: np.dtype[Any], channels: int
) -> Iterator[WriteRows]:
    grid = place.grid
    shape = (grid.height, grid.width, channels) if channels > 1 else (grid.height, grid.width)
    about: dict[str, Any] = {"photometric": "rgb", "extrasamples": ["unassalpha"]} if channels > 1 else {}
    rows_of_file = tifffile.memmap(
        path, shape=shape, dtype=dtype, bigtiff=np.prod(shape) * dtype.itemsize > 2**31, **about
    )

    def write(row: int, rows: _Rows) -> None:
        rows_of_file[row : row + len(rows)] = rows

    yield write
    rows_of_file.flush()
    x, y = place.corner
    half = grid.pixel / 2
    numbers = (grid.pixel, 0.0, 0.0, -grid.pixel, x + half, y - half)
    write_bytes(path.with_suffix(".tfw"), "".join(f"{n:.10f}\n" for n in numbers).encode())
