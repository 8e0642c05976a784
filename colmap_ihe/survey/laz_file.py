"""Write a cloud of points as LAZ, with its coordinate system, as programs for surveyors read it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.survey.cloud_system import (
    COLOURS,
    CloudSystem,
    Rows,
    chunks,
    missing_packages,
    system_of,
    whole_file,
)
from colmap_ihe.survey.frames import Frame

UNIT = "points as LAZ"
_TO_16_BIT = 257
_POINT_FORMAT = 7  # the least of LAS 1.4 with colours


def missing_for_laz(frame: Frame) -> list[str]:
    """Return the names of the packages that are not installed and without which `write_laz` cannot write."""
    return missing_packages(frame, "laspy", "lazrs")


def write_laz(path: Path, rows: Rows, frame: Frame, progress: Progress = SILENT) -> None:
    """Write points of the model's frame as `cloud_system.system_of` says.

    `rows` (N,): fields x, y, z in metres, and red, green, blue of 8 bit, which become 16. The file is whole or not
    there. Raises OSError and `Cancelled`."""
    import laspy

    system = system_of(rows, frame)
    header = _header(system)
    with (
        whole_file(path) as temporary,
        laspy.open(
            temporary, mode="w", header=header, do_compress=True, laz_backend=laspy.LazBackend.Lazrs
        ) as file,
    ):
        for chunk in chunks(rows, progress, UNIT):
            file.write_points(_points(chunk, header, system))


def _header(system: CloudSystem) -> Any:
    import laspy

    header = laspy.LasHeader(version="1.4", point_format=_POINT_FORMAT)
    header.generating_software = "colmap-ihe"
    header.offsets = system.offset
    header.scales = np.full(3, system.step_m)
    if system.crs:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(system.wkt()))
        header.global_encoding.wkt = True
    return header


def _points(rows: Rows, header: Any, system: CloudSystem) -> Any:
    import laspy

    points = laspy.ScaleAwarePointRecord.zeros(len(rows), header=header)
    points.x, points.y, points.z = system.coordinates(rows).T
    for name in COLOURS:
        points[name] = rows[name].astype(np.uint16) * _TO_16_BIT
    points.return_number[:] = 1
    points.number_of_returns[:] = 1
    return points
