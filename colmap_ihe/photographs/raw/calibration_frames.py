"""Calibration frames read in a decoder: as `raw` reads them, and a frame that crashes it is only left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.photographs.decode import refuse_too_large
from colmap_ihe.photographs.raw.develop import RawHeader, Sensor
from colmap_ihe.photographs.raw.mosaic import Mosaic


def read_header(path: Path) -> RawHeader:
    """As `raw.read_header`. Raises `PhotographError`."""
    found: Any = decoders.ask("header", path.name, path=str(path.absolute()))[0]
    with decoders.understood(path.name):
        width, height, sensor = int(found[0]), int(found[1]), str(found[2])
    refuse_too_large(path.name, width, height)
    return RawHeader(width, height, cast(Sensor, sensor))


def read_mosaic(path: Path) -> Mosaic:
    """As `raw.read_mosaic`. Raises `PhotographError`."""
    found, values = _array("mosaic", path)
    with decoders.understood(path.name):
        black = found["black"]
        plane = _array("black", path)[1] if black is None else np.array(black, np.float32)
        pattern = np.array(found["pattern"], np.uint8)
        if values.ndim != 2 or values.dtype != np.uint16 or pattern.ndim != 2 or plane.ndim != 2:
            raise ValueError(f"a mosaic of {values.shape} {values.dtype}")
        return Mosaic(values, pattern, plane, float(found["white"]))


def bad_pixel_candidates(path: Path) -> NDArray[np.intp]:
    """As `raw.bad_pixel_candidates`. Raises `PhotographError`."""
    found, _ = decoders.ask("bad pixels", path.name, 0, path=str(path.absolute()))
    with decoders.understood(path.name):
        return np.array(found, np.intp).reshape(-1, 2)


def _array(task: str, path: Path) -> tuple[Any, NDArray[Any]]:
    found, array = decoders.ask(task, path.name, 0, path=str(path.absolute()))
    if array is None:
        raise PhotographError(
            f"{path.name}: the decoder returned no pixels", hint="take it out of the folder"
        )
    return found, array
