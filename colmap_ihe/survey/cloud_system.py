"""Tell where the points of a model's cloud lie in the user's system, for files that hold whole numbers of steps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import numpy.typing as npt

from colmap_ihe.machine.files import replace_file
from colmap_ihe.machine.progress import Progress
from colmap_ihe.survey.frames import GPS, Frame
from colmap_ihe.survey.observations import F64

Rows = npt.NDArray[np.void]

STEP = 0.0001  # metres: the smallest step of a coordinate
COLOURS = ("red", "green", "blue")
_MOST_STEPS = 2**31 - 1
CHUNK = 1_000_000
"""Points in memory at a time."""

_OFFSET_STEP = 100.0  # metres


@dataclass(frozen=True)
class CloudSystem:
    """Hold the frame of a model and how its points are written: in metres of the system `crs`, empty for a local one,
    as whole numbers of steps of `step_m` from `offset` (3,) on."""

    frame: Frame
    crs: str
    offset: F64
    step_m: float

    def coordinates(self, rows: Rows) -> F64:
        """Return (N, 3) in metres of `crs`: points of the model's frame, with fields x, y and z."""
        points = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
        return _coordinates(points, self.frame, self.crs)

    def wkt(self) -> str:
        """Return `crs` as the first WKT, which LAS and E57 ask for, or the second where the first cannot tell it; empty
        for a local system."""
        if not self.crs:
            return ""
        import pyproj

        system = pyproj.CRS.from_user_input(self.crs)
        try:
            return str(system.to_wkt("WKT1_GDAL"))
        except pyproj.exceptions.CRSError:
            return str(system.to_wkt())


def system_of(rows: Rows, frame: Frame) -> CloudSystem:
    """Return how the points `rows` (N,) of a model in `frame` are written: in the user's system, or in WGS 84 / UTM of
    the zone where that is of degrees; in steps of `STEP`, or so much larger by powers of ten that 32 bit hold all."""
    crs = _metric_crs(frame)
    return CloudSystem(frame, crs, _offset(frame, crs), _step(rows, frame))


def missing_packages(frame: Frame, *writers: str) -> list[str]:
    """Return the names of the packages that are not installed: of `writers`, and of what a coordinate system needs."""
    with_crs = ["pyproj"] if frame.crs or frame.origin else []
    return [name for name in (*writers, *with_crs) if _is_missing(name)]


def _is_missing(name: str) -> bool:
    try:
        import_module(name)
    except ImportError:
        return True
    return False


def chunks(rows: Rows, progress: Progress, unit: str) -> Iterator[Rows]:
    """Yield points some at a time; what was yielded before is done. Raises `Cancelled`."""
    progress.start(len(rows), unit)
    for start in range(0, len(rows), CHUNK):
        chunk = rows[start : start + CHUNK]
        yield chunk
        progress.advance(len(chunk))


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to, which takes the name `path` at the end; where that fails it is removed, and what was at
    `path` stays. Raises OSError."""
    temporary = path.with_name(f".{path.name}.new")
    try:
        yield temporary
        replace_file(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _coordinates(points: F64, frame: Frame, crs: str) -> F64:
    if frame.origin is None:
        return frame.to_user(points)
    import pyproj

    degrees = Frame(GPS, origin=frame.origin).to_user(points)
    transformer = pyproj.Transformer.from_crs(GPS, crs, always_xy=True)
    return np.stack(transformer.transform(*degrees.T), axis=1)


def _metric_crs(frame: Frame) -> str:
    if frame.origin is None:
        return frame.crs
    import pyproj

    latitude, longitude, _ = frame.origin
    area = pyproj.aoi.AreaOfInterest(longitude, latitude, longitude, latitude)
    found = pyproj.database.query_utm_crs_info(datum_name="WGS 84", area_of_interest=area)
    return f"EPSG:{found[0].code}"


def _offset(frame: Frame, crs: str) -> F64:
    if frame.origin is None:
        return np.array(frame.offset)
    middle = _coordinates(np.zeros((1, 3)), frame, crs)[0]
    return np.asarray(np.round(middle / _OFFSET_STEP) * _OFFSET_STEP)


def _step(rows: Rows, frame: Frame) -> float:
    """Return the step in metres; the model's own coordinates and half a step of the offset bound what is written."""
    ends = [float(end) for axis in "xyz" if len(rows) for end in (rows[axis].min(), rows[axis].max())]
    farthest = max(map(abs, ends), default=0.0)
    reach = 2 * farthest + _OFFSET_STEP + (abs(frame.origin[2]) if frame.origin else 0.0)
    step = STEP
    while reach / step > _MOST_STEPS:
        step *= 10
    return step
