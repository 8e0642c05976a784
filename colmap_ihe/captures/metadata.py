"""EXIF: read from photographs of every kind, carried into the images we write.

COLMAP decides from EXIF which photographs share a camera and what its focal length is about, so what a
photograph says has to arrive. Broken EXIF loses the tag, not the photograph.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import exifread
from exifread.core.exceptions import ExifError
from exifread.utils import Ratio
from PIL import Image, UnidentifiedImageError
from PIL.TiffImagePlugin import IFDRational

from colmap_ihe.captures import decoders
from colmap_ihe.captures.profile import name_of_profile
from colmap_ihe.captures.raw import preview_of
from colmap_ihe.errors import PhotographError

EXIF_IFD, GPS_IFD = 0x8769, 0x8825
MAKE, MODEL, ORIENTATION = 0x010F, 0x0110, 0x0112
FOCAL_LENGTH, FOCAL_LENGTH_35MM, PIXEL_X, PIXEL_Y = 0x920A, 0xA405, 0xA002, 0xA003
EXPOSURE_TIME, F_NUMBER, ISO, SERIAL, LENS = 0x829A, 0x829D, 0x8827, 0xA431, 0xA434
_MAKER_NOTE, _INTEROPERABILITY = 0x927C, 0xA005
# What describes the photograph; the other tags of a TIFF's first directory describe the file they came in.
_IMAGE_TAGS = frozenset({0x010E, MAKE, MODEL, ORIENTATION, 0x0131, 0x0132, 0x013B, 0x8298})
_OF_THE_SHOT = (FOCAL_LENGTH, FOCAL_LENGTH_35MM, EXPOSURE_TIME, F_NUMBER, ISO)
_PREFIX = b"Exif\x00\x00"
_UNREADABLE = (
    PhotographError,
    ExifError,
    UnidentifiedImageError,
    OSError,
    SyntaxError,  # Pillow's word for a malformed file
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    struct.error,
    ZeroDivisionError,
    OverflowError,
)

logging.getLogger("exifread").setLevel(logging.CRITICAL)  # what it complains of is in `Metadata.problem`

_Tags = dict[int, Any]


@dataclass(frozen=True)
class Metadata:
    """What a photograph says of itself. `exif` is a TIFF structure to write into another file, or empty;
    lengths are in millimetres, `exposure_s` in seconds, 0 where unknown; `serial` is the camera's; `profile`
    names the colours of its RGB numbers; `problem` says in a few words what could not be read."""

    exif: bytes = b""
    make: str = ""
    model: str = ""
    focal_mm: float = 0.0
    focal_35mm: float = 0.0
    exposure_s: float = 0.0
    f_number: float = 0.0
    iso: float = 0.0
    lens: str = ""
    serial: str = ""
    orientation: int = 1
    has_gps: bool = False
    profile: str = "sRGB"
    pages: int = 1
    problem: str = ""


def read_metadata(path: Path, kind: str) -> Metadata:
    """Reads the EXIF of a capture; `kind` is "raw" or "coded". Never raises for what EXIF holds. A decoder does
    it, in a process of its own: profiles and previews are native libraries' work."""
    try:
        found, _ = decoders.ask("metadata", path.name, path=str(path.absolute()), kind=kind)
    except PhotographError as error:
        return Metadata(problem=f"EXIF not readable: {error}")
    values: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in found.items()}
    return Metadata(**values)


def read_metadata_here(path: Path, kind: str) -> Metadata:
    """As `read_metadata`, in this process."""
    try:
        if kind == "coded":
            return _read_coded(path)
        metadata = _read_raw(path)
        if metadata.make or metadata.focal_mm:
            return metadata
        # Fujifilm's RAF and Canon's CR3 keep EXIF where exifread does not look, and again in their preview.
        preview = preview_of(path)
        return _read_coded(BytesIO(preview)) if preview else metadata
    except _UNREADABLE as error:
        return Metadata(problem=f"EXIF not readable: {error or type(error).__name__}")


def _read_coded(source: Path | BytesIO) -> Metadata:
    with Image.open(source) as image:
        blob = image.info.get("exif", b"") if image.format in ("JPEG", "PNG", "MPO") else b""
        blob = blob.removeprefix(_PREFIX) if isinstance(blob, bytes) else b""
        found = image.getexif()
        tags = dict(found)
        exif, problem = _directory(found, EXIF_IFD)
        gps, gps_problem = _directory(found, GPS_IFD)
        profile, pages = _profile(image), _pages(image)
    problem = problem or gps_problem or _why_not_written(blob)
    if not blob or problem:  # rebuilt from what could be read; else carried over to the letter
        blob = build_exif({t: v for t, v in tags.items() if t in _IMAGE_TAGS}, exif, gps)
    return replace(_describe(blob, tags, exif, gps, problem), profile=profile, pages=pages)


def _why_not_written(blob: bytes) -> str:
    """Why EXIF, though Pillow reads it, could not be written into another file; empty if it can."""
    try:
        with_size(with_size(blob, 1, 1), 2, 2)
    except (*_UNREADABLE, AttributeError) as error:
        return f"part of the EXIF cannot be carried over: {error or type(error).__name__}"
    return ""


def _profile(image: Image.Image) -> str:
    try:
        return name_of_profile(image)
    except _UNREADABLE:
        return "sRGB"  # EXIF is broken where it could say more, and `problem` says so


def _pages(image: Image.Image) -> int:
    """Of a TIFF; the second picture of a JPEG is its preview. A page that is broken is none."""
    try:
        return int(getattr(image, "n_frames", 1)) if image.format == "TIFF" else 1
    except _UNREADABLE:
        return 1


def _directory(found: Image.Exif, tag: int) -> tuple[_Tags, str]:
    if tag not in found:
        return {}, ""
    try:
        return dict(found.get_ifd(tag)), ""
    except _UNREADABLE as error:
        return {}, f"part of the EXIF is not readable: {error or type(error).__name__}"


def _read_raw(path: Path) -> Metadata:
    with path.open("rb") as handle:
        found = exifread.process_file(handle, details=False)
    directories: dict[str, _Tags] = {"Image": {}, "EXIF": {}, "GPS": {}}
    for key, tag in found.items():
        group = key.partition(" ")[0]
        if group in directories and hasattr(tag, "values"):
            value = _plain(tag)
            if value is not None:
                directories[group][tag.tag] = value
    image, exif, gps = directories["Image"], directories["EXIF"], directories["GPS"]
    # Some makers write the shot's data into the first directory, as TIFF/EP allows.
    exif = {t: v for t, v in image.items() if t in _OF_THE_SHOT} | exif
    # An adapted lens says 0 mm: no information, and COLMAP would take it for some.
    exif = {t: v for t, v in exif.items() if t not in (FOCAL_LENGTH, FOCAL_LENGTH_35MM) or float(v) > 0}
    blob = build_exif({t: v for t, v in image.items() if t in _IMAGE_TAGS}, exif, gps)
    return _describe(blob, image, exif, gps, "" if found else "no EXIF found")


def _plain(tag: Any) -> Any:
    """A tag of exifread as Pillow wants it: text, bytes, a number or a tuple of numbers."""
    values = tag.values
    if isinstance(values, str | bytes):
        return values
    if tag.field_type in (6, 7) or not isinstance(values, list):
        return bytes(v & 0xFF for v in values) if isinstance(values, list) else None
    numbers = [IFDRational(v.num, v.den) if isinstance(v, Ratio) and v.den else v for v in values]
    if not numbers or any(isinstance(n, Ratio) and not isinstance(n, IFDRational) for n in numbers):
        return None
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


def build_exif(image: Mapping[int, Any], exif: Mapping[int, Any], gps: Mapping[int, Any]) -> bytes:
    """A TIFF structure of three directories; a tag that cannot be written is left out. Empty if all are."""
    target = Image.Exif()
    for directory, tags in ((None, image), (EXIF_IFD, exif), (GPS_IFD, gps)):
        kept = {
            t: v for t, v in tags.items() if t not in (_MAKER_NOTE, _INTEROPERABILITY) and _writable(t, v)
        }
        if directory is None:
            target.update(kept)
        elif kept:
            target.get_ifd(directory).update(kept)
    if not len(target) and not target.get_ifd(EXIF_IFD) and not target.get_ifd(GPS_IFD):
        return b""
    return target.tobytes().removeprefix(_PREFIX)


def _writable(tag: int, value: Any) -> bool:
    alone = Image.Exif()
    alone[tag] = value
    try:
        alone.tobytes()
    except (*_UNREADABLE, AttributeError):
        return False
    return True


def slimmed(blob: bytes, limit: int) -> bytes:
    """The same EXIF in fewer than `limit` bytes, where there is no room for more: without maker note and, if
    that is not enough, without values of more than 1 kB. Small EXIF stays as it is to the letter."""
    if len(blob) < limit:
        return blob
    exif = Image.Exif()
    exif.load(_PREFIX + blob)
    directories = [dict(exif), dict(exif.get_ifd(EXIF_IFD)), dict(exif.get_ifd(GPS_IFD))]
    image, inner, gps = ({t: v for t, v in d.items() if t not in (EXIF_IFD, GPS_IFD)} for d in directories)
    slim = build_exif(image, inner, gps)
    if len(slim) < limit:
        return slim
    return build_exif(*({t: v for t, v in d.items() if _is_short(v)} for d in (image, inner, gps)))


def _is_short(value: Any) -> bool:
    return not isinstance(value, str | bytes | tuple) or len(value) <= 1024


def with_size(blob: bytes, width: int, height: int) -> bytes:
    """The same EXIF with the pixel dimensions of the image it goes into; empty stays empty."""
    if not blob:
        return b""
    exif = Image.Exif()
    exif.load(_PREFIX + blob)
    directory = exif.get_ifd(EXIF_IFD)
    if (directory.get(PIXEL_X), directory.get(PIXEL_Y)) == (width, height):
        return blob  # to the letter, maker note and all
    directory[PIXEL_X], directory[PIXEL_Y] = width, height
    return exif.tobytes().removeprefix(_PREFIX)


def _describe(blob: bytes, image: _Tags, exif: _Tags, gps: _Tags, problem: str) -> Metadata:
    orientation = image.get(ORIENTATION, 1)
    return Metadata(
        exif=blob,
        make=_text(image.get(MAKE)),
        model=_text(image.get(MODEL)),
        focal_mm=_number(exif.get(FOCAL_LENGTH)),
        focal_35mm=_number(exif.get(FOCAL_LENGTH_35MM)),
        exposure_s=_number(exif.get(EXPOSURE_TIME)),
        f_number=_number(exif.get(F_NUMBER)),
        iso=_number(_first(exif.get(ISO))),
        lens=_text(exif.get(LENS)),
        serial=_text(exif.get(SERIAL)),
        orientation=orientation if orientation in range(1, 9) else 1,
        has_gps={2, 4, 6} <= set(gps),  # COLMAP wants latitude, longitude and altitude
        problem=problem,
    )


def _first(value: Any) -> Any:
    return value[0] if isinstance(value, tuple) and value else value


def _text(value: Any) -> str:
    return value.strip("\x00 ") if isinstance(value, str) else ""


def _number(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if 0 < number < 1e6 else 0.0
