"""Write a cloud of points as E57 (ASTM E2807), with its coordinate system, as programs for laser scans read it.

The cloud is one scan without a pose: its coordinates are those of the user's system, which every reader sees, also one
that leaves poses aside. The same cloud gives the same bytes: there is no date in it, and its GUIDs come from what it
holds.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xxhash

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.files import require_room
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.survey import cloud_system
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

UNIT, _UNIT_BEFORE = "points as E57", "points looked at for E57"
_FORMAT = "ASTM E57 3D Imaging Data File"
_AXES = ("cartesianX", "cartesianY", "cartesianZ")
_COLOURS = ("colorRed", "colorGreen", "colorBlue")
_BRIGHTEST = 255
_BYTES_A_POINT = 3 * 4 + 3
_GUIDS = uuid.UUID("5a0a3f0e-6a57-5f0c-9d51-8a6f6c1f0e57")
I32 = npt.NDArray[np.int32]


@dataclass(frozen=True)
class _Extent:
    """Hold the least and the largest number of steps (3,) of all points, and a digest of the whole cloud."""

    least: I32
    most: I32
    digest: str


def missing_for_e57(frame: Frame) -> list[str]:
    """Return the names of the packages that are not installed and without which `write_e57` cannot write."""
    return missing_packages(frame, "pye57")


def write_e57(path: Path, rows: Rows, frame: Frame, progress: Progress = SILENT) -> None:
    """Write points of the model's frame as `cloud_system.system_of` says.

    `rows` (N,), at least one: fields x, y, z in metres, and red, green, blue of 8 bit. The file is whole or not there.
    Raises `DiskFullError`, `ProjectError` where it cannot be written, OSError and `Cancelled`."""
    from pye57 import libe57

    system = system_of(rows, frame)
    require_room(path.parent, _BYTES_A_POINT * len(rows))
    extent = _extent(rows, system, progress)
    try:
        with whole_file(path) as temporary, _written(temporary) as image:
            _write_points(image, rows, system, extent, progress)
    except libe57.E57Exception as error:
        raise ProjectError(
            f"{path}: cannot be written as E57 ({str(error).splitlines()[0]})",
            hint="look whether its disk has room, and run again with --from dense",
        ) from error


@contextmanager
def _written(path: Path) -> Iterator[Any]:
    """Yield a file that is written, and close it; it is removed where that fails."""
    from pye57 import libe57

    image = libe57.ImageFile(str(path), "w")
    try:
        yield image
        image.close()
    finally:
        if image.isOpen():
            image.cancel()


def _steps(rows: Rows, system: CloudSystem) -> I32:
    """Return (N, 3): coordinates as whole numbers of steps."""
    return np.rint((system.coordinates(rows) - system.offset) / system.step_m).astype(np.int32)


def _extent(rows: Rows, system: CloudSystem, progress: Progress) -> _Extent:
    least, most = np.full(3, 2**31 - 1, np.int32), np.full(3, -(2**31), np.int32)
    digest = xxhash.xxh3_128(system.wkt().encode())
    for chunk in chunks(rows, progress, _UNIT_BEFORE):
        steps = _steps(chunk, system)
        least, most = np.minimum(least, steps.min(axis=0)), np.maximum(most, steps.max(axis=0))
        digest.update(steps.tobytes())
        digest.update(np.stack([chunk[name] for name in COLOURS]).tobytes())
    return _Extent(least, most, digest.hexdigest())


def _write_points(image: Any, rows: Rows, system: CloudSystem, extent: _Extent, progress: Progress) -> None:
    from pye57 import libe57

    scan = _scan(image, system, extent)
    points = libe57.CompressedVectorNode(
        image, _prototype(image, system, extent), libe57.VectorNode(image, True)
    )
    scan.set("points", points)
    scans = libe57.VectorNode(image, True)
    _fill_root(image, system, extent, scans)
    scans.append(scan)
    arrays, buffers = _buffers(image, len(rows))
    writer = points.writer(buffers)
    try:
        for chunk in chunks(rows, progress, UNIT):
            for name, values in zip(_AXES, _steps(chunk, system).T, strict=True):
                arrays[name][: len(chunk)] = values
            for name, colour in zip(_COLOURS, COLOURS, strict=True):
                arrays[name][: len(chunk)] = chunk[colour]
            writer.write(len(chunk))
    finally:
        writer.close()  # the library crashes where a file is cancelled with an open writer


def _fill_root(image: Any, system: CloudSystem, extent: _Extent, scans: Any) -> None:
    from pye57 import libe57

    image.extensionsAdd("", libe57.E57_V1_0_URI)
    root = image.root()
    root.set("formatName", libe57.StringNode(image, _FORMAT))
    root.set("guid", libe57.StringNode(image, _guid(f"{extent.digest} file")))
    root.set("versionMajor", libe57.IntegerNode(image, libe57.E57_FORMAT_MAJOR))
    root.set("versionMinor", libe57.IntegerNode(image, libe57.E57_FORMAT_MINOR))
    root.set("e57LibraryVersion", libe57.StringNode(image, libe57.E57_LIBRARY_ID))
    root.set("coordinateMetadata", libe57.StringNode(image, system.wkt()))
    root.set("data3D", scans)
    root.set("images2D", libe57.VectorNode(image, True))


def _scan(image: Any, system: CloudSystem, extent: _Extent) -> Any:
    """Return the node of the scan, without its points."""
    from pye57 import libe57

    scan, bounds = libe57.StructureNode(image), libe57.StructureNode(image)
    limits = libe57.StructureNode(image)
    least, most = (system.offset + steps * system.step_m for steps in (extent.least, extent.most))
    for axis, low, high in zip("xyz", least, most, strict=True):
        bounds.set(f"{axis}Minimum", libe57.FloatNode(image, float(low)))
        bounds.set(f"{axis}Maximum", libe57.FloatNode(image, float(high)))
    for name in _COLOURS:
        limits.set(f"{name}Minimum", libe57.IntegerNode(image, 0))
        limits.set(f"{name}Maximum", libe57.IntegerNode(image, _BRIGHTEST))
    scan.set("guid", libe57.StringNode(image, _guid(f"{extent.digest} scan")))
    scan.set("name", libe57.StringNode(image, "fused cloud"))
    scan.set("description", libe57.StringNode(image, "points of photographs, by colmap-ihe"))
    scan.set("cartesianBounds", bounds)
    scan.set("colorLimits", limits)
    return scan


def _prototype(image: Any, system: CloudSystem, extent: _Extent) -> Any:
    """Return the node that says of what kind the fields of a point are; their limits decide how many bits they take."""
    from pye57 import libe57

    prototype = libe57.StructureNode(image)
    for name, offset, least, most in zip(_AXES, system.offset, extent.least, extent.most, strict=True):
        kind = libe57.ScaledIntegerNode(
            image, int(least), int(least), int(most), system.step_m, float(offset)
        )
        prototype.set(name, kind)
    for name in _COLOURS:
        prototype.set(name, libe57.IntegerNode(image, 0, 0, _BRIGHTEST))
    return prototype


def _buffers(image: Any, points: int) -> tuple[Mapping[str, npt.NDArray[Any]], Any]:
    """Return arrays for the fields of some points by name, and the same as the library takes them: whole numbers as
    `long long`, for it reads others as 32 bit, whatever they are, or not at all."""
    from pye57 import libe57

    size = min(cloud_system.CHUNK, points)
    arrays: dict[str, npt.NDArray[Any]] = {name: np.zeros(size, np.longlong) for name in _AXES}
    arrays |= {name: np.zeros(size, np.uint8) for name in _COLOURS}
    buffers = libe57.VectorSourceDestBuffer()
    for name, values in arrays.items():
        buffers.append(libe57.SourceDestBuffer(image, name, values, size, True, False))
    return arrays, buffers


def _guid(of: str) -> str:
    return f"{{{uuid.uuid5(_GUIDS, of)}}}"
