"""Write a cloud as surveyors' programs read it: LAZ, in the coordinates of the survey, with its system.

Coordinates are whole tenths of a millimetre from an offset, so that those of a map lose nothing. A frame on the ground,
whose user's system is of degrees, is written in UTM on WGS 84, of its zone.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.survey.frames import GPS, Frame
from colmap_ihe.survey.observations import F64

STEP_M = 0.0001
_CHUNK = 1_000_000  # points, at a time in double precision
_NEEDED = ("laspy", "lazrs", "pyproj")
_TO_16_BIT = 257  # 255 becomes 65,535


def missing_libraries() -> list[str]:
    """Return the names of the libraries that a LAZ file needs and that are not installed."""
    return [name for name in _NEEDED if find_spec(name) is None]


def write_laz(file: Path, rows: NDArray[np.void], frame: Frame, progress: Progress = SILENT) -> None:
    """Write the points of a PLY file (N,), with x, y, z in the model's frame and red, green, blue of 8 bit, as `file`:
    whole, or not at all. To be called where nothing of `missing_libraries` is missing. Raises `Cancelled`."""
    import laspy

    system = _system(frame)
    header = laspy.LasHeader(point_format=7, version="1.4")
    if system is not None:
        header.add_crs(system)
    header.scales = np.full(3, STEP_M)
    first = _coordinates(rows[:1], frame, system)
    header.offsets = np.floor(first[0] / 1000) * 1000 if len(first) else np.zeros(3)
    part = file.with_name(f"{file.stem}.part.ply{file.suffix}")  # whose remains any run removes
    try:
        with laspy.open(part, mode="w", header=header, do_compress=True) as writer:
            for start in range(0, len(rows), _CHUNK):
                progress.check()
                writer.write_points(_record(rows[start : start + _CHUNK], frame, system, header))
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def _record(rows: NDArray[np.void], frame: Frame, system: Any, header: Any) -> Any:
    import laspy

    record = laspy.ScaleAwarePointRecord.zeros(len(rows), header=header)
    record.x, record.y, record.z = _coordinates(rows, frame, system).T
    for name in ("red", "green", "blue"):
        record[name] = rows[name].astype(np.uint16) * _TO_16_BIT
    return record


def _system(frame: Frame) -> Any:
    """Return the system of the file as pyproj knows it, None of a local one."""
    import pyproj

    if frame.origin is None:
        return pyproj.CRS.from_user_input(frame.crs) if frame.crs else None
    latitude, longitude, _ = frame.origin
    zone = int((longitude + 180) // 6) % 60 + 1
    return pyproj.CRS.from_epsg((32600 if latitude >= 0 else 32700) + zone)


def _coordinates(rows: NDArray[np.void], frame: Frame, system: Any) -> F64:
    """Return (N, 3) float64: places of points in the file's system."""
    user = frame.to_user(np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1))
    if frame.origin is None or not len(user):
        return user
    import pyproj

    transformer = pyproj.Transformer.from_crs(frame.crs or GPS, system, always_xy=True)
    return np.stack(transformer.transform(*user.T), axis=1)
