"""Bring coordinates of a survey into a frame of metres near the origin, z up, and back.

Depth and clouds are kept in single precision, which holds a UTM coordinate to half a metre. So models lie near the
origin: shifted by whole hundreds of metres in a system of metres, and on the plane that touches the earth (x east, y
north, z up) where coordinates are degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import CapabilityError, ControlFileError, OptionError
from colmap_ihe.survey.observations import F64

GPS = "EPSG:4979"
"""The system of GPS: longitude, latitude and height above the ellipsoid."""

_FAR = 1000.0  # metres from the origin, from where on coordinates are shifted
_STEP = 100.0  # metres, of the shift
_DEGREES_SPREAD = 0.02  # degrees: two kilometres; metres that lie so close together are no building
_AREA_MARGIN = 5.0  # degrees about the area that a system is for


@dataclass(frozen=True)
class Frame:
    """Hold how the model's coordinates are told in the user's system `crs`, empty for a local one in metres.

    Where that is of metres, `offset` (x, y, z) is added to the model's. Where it is of degrees the model is east, north
    and up of `origin`: latitude, longitude and height on WGS 84.
    """

    crs: str = ""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    origin: tuple[float, float, float] | None = None

    def to_model(self, coordinates: F64) -> F64:
        """Return (N, 3): coordinates (N, 3) of the user's system in the model's frame."""
        if self.origin is None:
            return np.asarray(coordinates, np.float64) - self.offset
        return np.asarray(
            pycolmap.GPSTransform().ellipsoid_to_enu(_latitude_first(coordinates, self.crs), *self.origin)
        )

    def to_user(self, points: F64) -> F64:
        """Return (N, 3): points (N, 3) of the model's frame in the user's system."""
        if self.origin is None:
            return np.asarray(points, np.float64) + self.offset
        found = np.asarray(pycolmap.GPSTransform().enu_to_ellipsoid(points, *self.origin))
        degrees = found[:, [1, 0, 2]]
        return degrees if self.crs == GPS else _transformed(degrees, GPS, self.crs)


def frame_of(crs: str, coordinates: Sequence[tuple[float, float, float]]) -> Frame:
    """Return the frame for coordinates of a system: an EPSG code, WKT, or what PROJ else knows; empty for a local one.
    Raises `ControlFileError` where coordinates cannot be of that system, `OptionError` for one that is not known, and
    `CapabilityError` where pyproj, which knows them, is not installed."""
    values = np.array(coordinates, np.float64).reshape(-1, 3)
    if not crs:
        _refuse_degrees(values)
        return Frame("", _offset(values))
    if crs == GPS:
        return _on_the_ground(crs, values)
    system = _system(crs)
    if system.is_geographic:
        return _on_the_ground(crs, values)
    if not system.is_projected:
        raise OptionError(
            f"survey.crs {crs} is no system of a map or of degrees", hint="name one, as EPSG:25832"
        )
    units = {axis.unit_name for axis in system.axis_info[:2]}
    if units != {"metre"}:
        raise OptionError(
            f"survey.crs {crs} is in {', '.join(sorted(units))}, expected metres",
            hint="convert the coordinates",
        )
    _refuse_elsewhere(crs, system, values)
    return Frame(crs, _offset(values))


def _offset(values: F64) -> tuple[float, float, float]:
    middle = np.median(values, axis=0) if len(values) else np.zeros(3)
    x, y, z = np.where(np.abs(middle) > _FAR, np.round(middle / _STEP) * _STEP, 0.0).tolist()
    return x, y, z


def _refuse_degrees(values: F64) -> None:
    if len(values) < 2:
        return
    across = values[:, :2]
    on_earth = (np.abs(across[:, 0]) <= 180).all() and (np.abs(across[:, 1]) <= 90).all()
    if (
        on_earth
        and (np.ptp(across, axis=0) < _DEGREES_SPREAD).all()
        and (np.abs(across) > 1).any(axis=0).all()
    ):
        x, y = across[0]
        raise ControlFileError(
            f"coordinates as x {x:.6f}, y {y:.6f} look like degrees, expected metres",
            hint="set survey.crs to the system they are in, as EPSG:4326 (x is then the longitude)",
        )


def _on_the_ground(crs: str, values: F64) -> Frame:
    wrong = (np.abs(values[:, 0]) > 180) | (np.abs(values[:, 1]) > 90)
    if wrong.any():
        x, y, _ = values[int(np.argmax(wrong))]
        raise ControlFileError(
            f"x {x:.2f}, y {y:.2f} are no longitude and latitude in degrees, which survey.crs {crs} has",
            hint="set survey.crs to the system of these coordinates, as EPSG:25832",
        )
    latitude, longitude, height = np.median(_latitude_first(values, crs), axis=0).tolist()
    return Frame(crs, origin=(latitude, longitude, height))


def _latitude_first(coordinates: F64, crs: str) -> F64:
    degrees = coordinates if crs == GPS else _transformed(coordinates, crs, GPS)
    return np.asarray(degrees, np.float64)[:, [1, 0, 2]]


def _refuse_elsewhere(crs: str, system: Any, values: F64) -> None:
    """Raise `ControlFileError` where coordinates lie far from where a system is used."""
    area = system.area_of_use
    if area is None or not len(values):
        return
    places = _transformed(values, crs, GPS)
    inside = (
        (places[:, 0] >= area.west - _AREA_MARGIN)
        & (places[:, 0] <= area.east + _AREA_MARGIN)
        & (places[:, 1] >= area.south - _AREA_MARGIN)
        & (places[:, 1] <= area.north + _AREA_MARGIN)
    )
    if not inside.all():  # also what is no number, of a place that the map cannot show
        x, y, _ = values[int(np.argmin(inside))]
        raise ControlFileError(
            f"x {x:.2f}, y {y:.2f} lie far outside of the area of survey.crs {crs} ({area.name:.80})",
            hint="see that survey.crs names the system of the coordinates, and x and y are not exchanged",
        )


def _transformed(coordinates: F64, source: str, target: str) -> F64:
    transformer = _pyproj(source).Transformer.from_crs(source, target, always_xy=True)
    return np.stack(transformer.transform(*np.asarray(coordinates, np.float64).T), axis=1)


def _system(crs: str) -> Any:
    pyproj = _pyproj(crs)
    try:
        return pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        raise OptionError(
            f"survey.crs {crs!r:.60} is no coordinate system that PROJ knows",
            hint="name its code, as EPSG:25832",
        ) from error


def _pyproj(crs: str) -> Any:
    try:
        import pyproj
    except ImportError as error:
        raise CapabilityError(
            f"survey.crs is {crs:.60}, and pyproj, which knows coordinate systems, is not installed",
            hint="pip install 'colmap-ihe[survey]'; a local system in metres needs no survey.crs",
        ) from error
    return pyproj
