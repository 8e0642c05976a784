"""Write a cloud of points as LAZ, with its coordinate system, as programs for surveyors read it."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from colmap_ihe.machine.files import replace_file
from colmap_ihe.survey.frames import GPS, Frame
from colmap_ihe.survey.observations import F64

SCALE = 0.0001  # metres: the smallest step of a coordinate
_MOST_STEPS = 2**31 - 1
_CHUNK = 1_000_000  # points in memory at a time
_TO_16_BIT = 257
_OFFSET_STEP = 100.0  # metres
_POINT_FORMAT = 7  # the least of LAS 1.4 with colours


@dataclass(frozen=True)
class _Target:
    """Hold the frame of a model and the system `crs` that its points are written in, empty for a local one."""

    frame: Frame
    crs: str

    def coordinates(self, points: F64) -> F64:
        """Return (N, 3) in metres of `crs`: points (N, 3) of the model's frame."""
        if self.frame.origin is None:
            return self.frame.to_user(points)
        import pyproj

        degrees = Frame(GPS, origin=self.frame.origin).to_user(points)
        transformer = pyproj.Transformer.from_crs(GPS, self.crs, always_xy=True)
        return np.stack(transformer.transform(*degrees.T), axis=1)


def missing_libraries(frame: Frame) -> list[str]:
    """Return the names of the packages that are not installed and without which `write_laz` cannot write."""
    missing = [] if _can_import("laspy") else ["laspy"]
    missing += [] if _can_import("lazrs") else ["lazrs"]
    if frame.crs or frame.origin:
        missing += [] if _can_import("pyproj") else ["pyproj"]
    return missing


def _can_import(name: str) -> bool:
    try:
        import_module(name)
    except ImportError:
        return False
    return True


def write_laz(path: Path, rows: npt.NDArray[np.void], frame: Frame) -> None:
    """Write points of the model's frame in the user's system, or in WGS 84 / UTM of the zone where that is of degrees.

    `rows` (N,): fields x, y, z in metres, and red, green, blue of 8 bit, which become 16. The file is whole or not
    there. Its scale is `SCALE`, or so much larger by powers of ten that all points can be told."""
    import laspy

    target = _Target(frame, _metric_crs(frame))
    header = _header(rows, target)
    temporary = path.with_name(f".{path.name}.new")
    with laspy.open(
        temporary, mode="w", header=header, do_compress=True, laz_backend=laspy.LazBackend.Lazrs
    ) as file:
        for start in range(0, len(rows), _CHUNK):
            file.write_points(_points(rows[start : start + _CHUNK], header, target))
    replace_file(temporary, path)


def _metric_crs(frame: Frame) -> str:
    if frame.origin is None:
        return frame.crs
    import pyproj

    latitude, longitude, _ = frame.origin
    area = pyproj.aoi.AreaOfInterest(longitude, latitude, longitude, latitude)
    found = pyproj.database.query_utm_crs_info(datum_name="WGS 84", area_of_interest=area)
    return f"EPSG:{found[0].code}"


def _header(rows: npt.NDArray[np.void], target: _Target) -> Any:
    import laspy

    header = laspy.LasHeader(version="1.4", point_format=_POINT_FORMAT)
    header.generating_software = "colmap-ihe"
    header.offsets = _offset(target)
    header.scales = np.full(3, _scale(rows, target))
    if target.crs:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(_wkt(target.crs)))
        header.global_encoding.wkt = True
    return header


def _wkt(crs: str) -> str:
    """Return a system as the first WKT, which LAS asks for, or the second where the first cannot tell it."""
    import pyproj

    system = pyproj.CRS.from_user_input(crs)
    try:
        return str(system.to_wkt("WKT1_GDAL"))
    except pyproj.exceptions.CRSError:
        return str(system.to_wkt())


def _offset(target: _Target) -> F64:
    if target.frame.origin is None:
        return np.array(target.frame.offset)
    middle = target.coordinates(np.zeros((1, 3)))[0]
    return np.asarray(np.round(middle / _OFFSET_STEP) * _OFFSET_STEP)


def _scale(rows: npt.NDArray[np.void], target: _Target) -> float:
    """Return the step in metres; the model's own coordinates and half a step of the offset bound what is written."""
    ends = [float(end) for axis in "xyz" if len(rows) for end in (rows[axis].min(), rows[axis].max())]
    farthest = max(map(abs, ends), default=0.0)
    reach = 2 * farthest + _OFFSET_STEP + (abs(target.frame.origin[2]) if target.frame.origin else 0.0)
    scale = SCALE
    while reach / scale > _MOST_STEPS:
        scale *= 10
    return scale


def _points(rows: npt.NDArray[np.void], header: Any, target: _Target) -> Any:
    import laspy

    points = laspy.ScaleAwarePointRecord.zeros(len(rows), header=header)
    model = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
    points.x, points.y, points.z = target.coordinates(model).T
    for name in ("red", "green", "blue"):
        points[name] = rows[name].astype(np.uint16) * _TO_16_BIT
    points.return_number[:] = 1
    points.number_of_returns[:] = 1
    return points
