"""Blocks of EXIF: TIFF structures of a directory of the image, one of the shot and one of GPS.

They go from file to file to the letter where that can be, since a maker note holds offsets into the block that
it came in; where a tag has to change, the block is written anew, without the maker note. Read and written
with Pillow.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from fractions import Fraction
from io import BytesIO
from mmap import mmap
from typing import Any

from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from colmap_ihe.photographs.exif.repair import mend

Tags = dict[int, Any]
"""Values by number, as Pillow has them: text, bytes, numbers, tuples of numbers."""


class Tag(IntEnum):
    """Number the tags that are of use here: TIFF 6.0, Exif 2.32."""

    EXIF_IFD, GPS_IFD, INTEROPERABILITY_IFD = 0x8769, 0x8825, 0xA005
    MAKE, MODEL, ORIENTATION = 0x010F, 0x0110, 0x0112
    FOCAL_LENGTH, FOCAL_LENGTH_35MM, PIXEL_X, PIXEL_Y = 0x920A, 0xA405, 0xA002, 0xA003
    PLANE_X, PLANE_Y, PLANE_UNIT = 0xA20E, 0xA20F, 0xA210  # focal-plane resolution, in pixels per unit
    EXPOSURE_TIME, F_NUMBER, ISO, TAKEN = 0x829A, 0x829D, 0x8827, 0x9003
    SERIAL, LENS_RANGE, LENS_MAKE, LENS = 0xA431, 0xA432, 0xA433, 0xA434
    MAKER_NOTE = 0x927C


# What describes the photograph; the other tags of a first directory describe the file they came in.
IMAGE_TAGS = frozenset({0x010E, Tag.MAKE, Tag.MODEL, Tag.ORIENTATION, 0x0131, 0x0132, 0x013B, 0x013C, 0x8298})
PREFIX = b"Exif\x00\x00"
UNREADABLE = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    ArithmeticError,
    struct.error,
)
"""What Pillow raises for EXIF that it cannot read or write; SyntaxError is its word for a malformed file."""

_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # 2, 3: Exif 2.32; 4, 5: TIFF/EP, which COLMAP reads too
_FIX = (2, 4, 6)  # of the directory of GPS: latitude, longitude, altitude
_SAME = 0.03  # of a side: a RAW file has a few rows and columns more than the camera's own picture


@dataclass(frozen=True)
class Directories:
    """Hold what is in a block; `lost` tags could not be read; `interoperability` is its index, as "R98"."""

    image: Tags = field(default_factory=dict)
    shot: Tags = field(default_factory=dict)
    gps: Tags = field(default_factory=dict)
    lost: int = 0
    interoperability: str = ""


class _Text(str):
    """Hold text that Pillow read as Latin-1, byte for byte, and would write as ASCII, and write the same bytes."""

    __slots__ = ()

    def encode(self, encoding: str = "latin-1", errors: str = "replace") -> bytes:
        return super().encode("latin-1", "replace")


def text(value: str) -> str:
    """Return text as EXIF holds it: in UTF-8, seen byte for byte."""
    return value.encode().decode("latin-1")


def take_apart(block: bytearray | mmap) -> Directories:
    """Return the directories of a block, or of a file of TIFF's kind, which is mended in place. Raises one of
    `UNREADABLE` where it has no such structure at all."""
    lost = mend(block)
    exif = Image.Exif()
    exif.load_from_fp(BytesIO(block) if isinstance(block, bytearray) else block)  # type: ignore[arg-type]
    return contents(exif, lost)


def contents(exif: Image.Exif, lost: int = 0) -> Directories:
    """Return the directories that Pillow found, with the number of tags that it could not read added to `lost`."""
    image, image_lost = _read(exif)
    shot, shot_lost = _read(exif, Tag.EXIF_IFD)
    gps, gps_lost = _read(exif, Tag.GPS_IFD)
    index = _read(exif, Tag.INTEROPERABILITY_IFD)[0].get(1) if Tag.INTEROPERABILITY_IFD in shot else ""
    lost += image_lost + shot_lost + gps_lost
    return Directories(image, shot, gps, lost, index.strip("\x00") if isinstance(index, str) else "")


def _read(exif: Image.Exif, directory: int | None = None) -> tuple[Tags, int]:
    """Return the tags of one directory, and how many could not be read."""
    tags: Tags = {}
    lost = 0
    try:
        inner = exif if directory is None else exif.get_ifd(directory)
    except UNREADABLE:
        return {}, 1
    for tag in list(inner):
        try:
            tags[tag] = inner[tag]
        except UNREADABLE:
            lost += 1
    return tags, lost


def put_together(image: Mapping[int, Any], shot: Mapping[int, Any], gps: Mapping[int, Any]) -> bytes:
    """Return a block of these tags, without those that cannot be written, empty if none can; without maker note and
    the directory of interoperability, which hold offsets."""
    target = Image.Exif()
    for number, tags in ((None, image), (Tag.EXIF_IFD, shot), (Tag.GPS_IFD, gps)):
        left_out = (
            (Tag.EXIF_IFD, Tag.GPS_IFD) if number is None else (Tag.MAKER_NOTE, Tag.INTEROPERABILITY_IFD)
        )
        kept = {t: _as_written(v) for t, v in tags.items() if t not in left_out}
        kept = {t: v for t, v in kept.items() if _writable(number, t, v)}
        if kept:
            (target if number is None else target.get_ifd(number)).update(kept)
    if not len(target) and not target.get_ifd(Tag.EXIF_IFD) and not target.get_ifd(Tag.GPS_IFD):
        return b""
    return target.tobytes().removeprefix(PREFIX)


def _as_written(value: Any) -> Any:
    return _Text(value) if isinstance(value, str) else value


def _writable(directory: int | None, tag: int, value: Any) -> bool:
    alone = Image.Exif()
    (alone if directory is None else alone.get_ifd(directory))[tag] = value
    try:
        alone.tobytes()
    except UNREADABLE:
        return False
    return True


def changed(block: bytes, image: Mapping[int, Any], shot: Mapping[int, Any]) -> bytes:
    """Return the block with these tags in place of what it has; None takes one out."""
    directories = take_apart(bytearray(block)) if block else Directories()
    return put_together(
        _present(directories.image | dict(image)), _present(directories.shot | dict(shot)), directories.gps
    )


def _present(tags: Tags) -> Tags:
    return {tag: value for tag, value in tags.items() if value is not None}


def for_tiff(block: bytes) -> Image.Exif:
    """Return the block for Pillow to write into a TIFF file, whose first directory has tags of its own for size and
    layout."""
    target = Image.Exif()
    if block:
        directories = take_apart(bytearray(block))
        target.load(put_together(photographic(directories.image), directories.shot, directories.gps))
        for tags in (target, target.get_ifd(Tag.EXIF_IFD), target.get_ifd(Tag.GPS_IFD)):
            tags.update({tag: _as_written(tags[tag]) for tag in list(tags)})
    return target


def photographic(image: Mapping[int, Any]) -> Tags:
    """Return the tags of a first directory that describe the photograph and not the file."""
    return {tag: value for tag, value in image.items() if tag in IMAGE_TAGS and value != ""}


def slimmed(block: bytes, limit: int) -> bytes:
    """Return the same EXIF in fewer than `limit` bytes, where there is no room for more: without maker note and, if
    that is not enough, without values of more than 1 kB. Small EXIF stays as it is to the letter."""
    if len(block) < limit:
        return block
    found = take_apart(bytearray(block))
    directories = (found.image, found.shot, found.gps)
    slim = put_together(*directories)
    if len(slim) < limit:
        return slim
    return put_together(*({t: v for t, v in tags.items() if _is_short(v)} for tags in directories))


def _is_short(value: Any) -> bool:
    return not isinstance(value, str | bytes | tuple) or len(value) <= 1024


def with_size(block: bytes, width: int, height: int) -> bytes:
    """Return the block for an image of this size in pixels: with its dimensions, and with the focal-plane resolution
    of its pixels where the dimensions were others. Empty stays empty.

    The resolution stays as it is where one side is as it was (something was cut off the other), goes with the
    size where both sides have changed alike, and is left out where they have not: nothing then says what the
    tags were about.
    """
    if not block:
        return b""
    shot = take_apart(bytearray(block)).shot
    old = number(shot.get(Tag.PIXEL_X)), number(shot.get(Tag.PIXEL_Y))
    if old == (width, height):
        return block
    new: Tags = {Tag.PIXEL_X: width, Tag.PIXEL_Y: height}
    if min(old) > 0 and Tag.PLANE_X in shot:
        plane: Tags = {Tag.PLANE_X: shot[Tag.PLANE_X], Tag.PLANE_Y: shot.get(Tag.PLANE_Y)}
        if (old[0] > old[1]) != (width > height) and old[0] != old[1] and width != height:  # turned
            old = old[1], old[0]
            plane = {Tag.PLANE_X: plane[Tag.PLANE_Y] or plane[Tag.PLANE_X], Tag.PLANE_Y: plane[Tag.PLANE_X]}
        new |= _scaled(plane, width / old[0], height / old[1])
    return changed(block, {}, new)


def _scaled(plane: Tags, x: float, y: float) -> Tags:
    """Return focal-plane resolution after the sides became `x` and `y` times as long."""
    if min(abs(x - 1), abs(y - 1)) <= _SAME:
        return plane
    if abs(x / y - 1) > _SAME:
        return {Tag.PLANE_X: None, Tag.PLANE_Y: None, Tag.PLANE_UNIT: None}
    return {
        t: rational(number(v) * s) if number(v) else None
        for (t, v), s in zip(plane.items(), (x, y), strict=True)
    }


def pixels_per_mm(shot: Mapping[int, Any]) -> float:
    """Return pixels per mm on the sensor, across the image, by focal-plane resolution as COLMAP reads it; 0 if
    unknown."""
    unit = shot.get(Tag.PLANE_UNIT)
    mm = _MM_PER_UNIT.get(unit, 0.0) if isinstance(unit, int) else 0.0
    return number(shot.get(Tag.PLANE_X)) / mm if mm else 0.0


def has_fix(gps: Mapping[int, Any]) -> bool:
    """Tell whether a directory of GPS names a place, by latitude, longitude and altitude, of which COLMAP wants all."""
    parts = [_finite(gps.get(tag)) for tag in _FIX]
    return all(parts) and is_place(*(sum(part / 60**n for n, part in enumerate(of_one)) for of_one in parts))


def is_place(latitude: float, longitude: float, altitude: float) -> bool:
    """Tell whether a fix, in degrees and metres, is of a place: finite, not beyond a pole, and not 0 degrees both north
    and east, as a receiver without satellites writes."""
    is_known = all(map(math.isfinite, (latitude, longitude, altitude))) and (latitude or longitude) != 0
    return is_known and abs(latitude) <= 90 and abs(longitude) <= 180


def _finite(value: Any) -> list[float]:
    """Return the numbers of a tag, empty if one of them is none."""
    try:
        numbers = [float(part) for part in (value if isinstance(value, tuple) else (value,))]
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def plane_tags(pixels_per_mm: float) -> Tags:
    """Return the focal-plane resolution of square pixels, per centimetre: of the units in Exif, COLMAP has this one
    most exactly."""
    resolution = rational(pixels_per_mm * 10)
    return {Tag.PLANE_X: resolution, Tag.PLANE_Y: resolution, Tag.PLANE_UNIT: 3}


def rational(value: float) -> IFDRational:
    """Return a positive number as two of 32 bits."""
    exact = Fraction(value).limit_denominator(max(1, min(1_000_000, int(2**31 / value))))
    return IFDRational(max(1, exact.numerator), exact.denominator)


def number(value: Any) -> float:
    """Return a positive number below a million, the first of several; else 0."""
    if isinstance(value, tuple) and value:
        value = value[0]
    try:
        result = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return 0.0
    return result if math.isfinite(result) and 0 < result < 1e6 else 0.0
