"""EXIF of photographs of every kind.

COLMAP decides from EXIF which photographs share a camera and what its focal length is about, so what a
photograph says has to arrive. Broken EXIF loses the tag, not the photograph.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, replace
from io import BytesIO
from mmap import ACCESS_COPY, mmap
from pathlib import Path
from typing import Any, BinaryIO

from PIL import Image, UnidentifiedImageError

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_pool import in_decoder
from colmap_ihe.photographs import heic
from colmap_ihe.photographs.coded import FORMATS
from colmap_ihe.photographs.container import set_orientation, without_text
from colmap_ihe.photographs.exif import blocks, cr3
from colmap_ihe.photographs.exif.blocks import UNREADABLE, Directories, Tag, number, put_together, take_apart
from colmap_ihe.photographs.icc_profile import name_of_profile
from colmap_ihe.photographs.raw.develop import LibrawMetadata, libraw_metadata, preview_of

_UNREADABLE = (PhotographError, UnidentifiedImageError, Image.DecompressionBombError, *UNREADABLE)
# Of the shot, where makers write it into the first directory, as TIFF/EP allows.
_NEVER_ZERO = (Tag.EXPOSURE_TIME, Tag.F_NUMBER, Tag.ISO, Tag.FOCAL_LENGTH, Tag.FOCAL_LENGTH_35MM)
_OF_THE_SHOT = frozenset(
    {*_NEVER_ZERO, Tag.TAKEN, 0x9004, 0x9290, 0x9291, 0x9292, Tag.PLANE_X, Tag.PLANE_Y, Tag.PLANE_UNIT}
    | {Tag.SERIAL, Tag.LENS_RANGE, Tag.LENS_MAKE, Tag.LENS}
)
_OF_DNG = {0xC62F: Tag.SERIAL, 0xC630: Tag.LENS_RANGE}  # DNG 1.4: CameraSerialNumber, LensInfo
_TOO_MUCH_TEXT = "MAX_TEXT"  # in Pillow's words of a PNG
_GPANO = re.compile(rb"GPano:ProjectionType\s*(?:=\s*[\"']|>)\s*([A-Za-z]{1,40})")
_CUSTOM_RENDERED, _APPLES_PANORAMA = 0xA401, 6
_NO_EXIF = "no EXIF found"
_TIFF, _BIG_TIFF = (b"II*\x00", b"MM\x00*"), (b"II+\x00", b"MM\x00+")


@dataclass(frozen=True)
class Metadata:
    """Hold what a photograph says of itself. `exif` is a TIFF structure to write into another file, or empty; lengths
    are in millimetres, `exposure_s` in seconds, 0 where unknown; `pixels_per_mm` is the resolution on the sensor;
    `serial` is the camera's; `profile` names the colours of its RGB numbers; `problem` says in a few words what could
    not be read; `projection` of a panorama, as "equirectangular", empty for a photograph through one lens; `taken`:
    when, as EXIF writes it."""

    exif: bytes = b""
    make: str = ""
    model: str = ""
    focal_mm: float = 0.0
    focal_35mm: float = 0.0
    pixels_per_mm: float = 0.0
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
    projection: str = ""
    taken: str = ""


def read_metadata(path: Path, kind: str) -> Metadata:
    """Return what the EXIF of a capture says; `kind` is "raw" or "coded". Never raises for what EXIF holds. A decoder
    reads it, in a process of its own: profiles and previews are native libraries' work."""
    try:
        metadata = in_decoder(decode_metadata, path, kind)
        if metadata.exif:
            take_apart(bytearray(metadata.exif))
        return metadata
    except _UNREADABLE as error:
        return Metadata(problem=_unreadable(error))


def decode_metadata(path: Path, kind: str) -> Metadata:
    """Return what `read_metadata` does, in this process."""
    try:
        return _read_coded(path) if kind == "coded" else _read_raw(path)
    except _UNREADABLE as error:
        return Metadata(problem=_unreadable(error))


def describe(block: bytes, other: Metadata | None = None) -> Metadata:
    """Return what a block of EXIF says; what is not of EXIF (profile, pages, problem, projection) as in `other`."""
    directories = take_apart(bytearray(block)) if block else Directories()
    image, shot = directories.image, directories.shot
    orientation = image.get(Tag.ORIENTATION, 1)
    other = other or Metadata()
    stitched = shot.get(_CUSTOM_RENDERED) == _APPLES_PANORAMA and _text(image.get(Tag.MAKE)) == "Apple"
    return replace(
        other,
        exif=block,
        projection=other.projection or ("cylindrical" if stitched else ""),
        make=_text(image.get(Tag.MAKE)),
        model=_text(image.get(Tag.MODEL)),
        focal_mm=number(shot.get(Tag.FOCAL_LENGTH)),
        focal_35mm=number(shot.get(Tag.FOCAL_LENGTH_35MM)),
        pixels_per_mm=blocks.pixels_per_mm(shot),
        exposure_s=number(shot.get(Tag.EXPOSURE_TIME)),
        f_number=number(shot.get(Tag.F_NUMBER)),
        iso=number(shot.get(Tag.ISO)),
        lens=_text(shot.get(Tag.LENS)),
        serial=_text(shot.get(Tag.SERIAL)),
        orientation=orientation if orientation in range(1, 9) else 1,
        has_gps=blocks.has_fix(directories.gps),
        taken=_text(shot.get(Tag.TAKEN)),
    )


def sized(metadata: Metadata, width: int, height: int) -> Metadata:
    """Return the metadata for an image of this size in pixels, which its EXIF may not be about."""
    block = blocks.with_size(metadata.exif, width, height)
    return metadata if block == metadata.exif else describe(block, metadata)


def _read_coded(source: Path | BytesIO) -> Metadata:
    """Read what Pillow opens. Text of a PNG may hold its EXIF, and where Pillow has too much of it counts for none."""
    heic.register()
    try:
        return _read_opened(source, source)
    except ValueError as error:
        if isinstance(source, BytesIO) or _TOO_MUCH_TEXT not in str(error):
            raise
        with source.open("rb") as file:
            return replace(_read_opened(without_text(file), source), problem="its text is too long")


def _read_opened(file: Path | BinaryIO, source: Path | BytesIO) -> Metadata:
    with Image.open(file, formats=FORMATS) as image:
        try:
            block, directories = _block_of(image, source)
            problem = _problem(directories.lost)
        except UNREADABLE as error:
            if _TOO_MUCH_TEXT in str(error):
                raise
            block, directories, problem = b"", Directories(), _unreadable(error)
        profile = name_of_profile(image, directories.interoperability)
        projection = _projection(image.info.get("xmp", b""))
        read = Metadata(profile=profile, pages=_pages(image), problem=problem, projection=projection)
        return describe(block, read)


def _projection(xmp: bytes | str) -> str:
    """Return the projection that XMP says, by Google's GPano, empty if none."""
    found = _GPANO.search(xmp.encode("utf-8", "replace") if isinstance(xmp, str) else xmp)
    return found[1].decode("ascii").lower() if found else ""


def _block_of(image: Image.Image, source: Path | BytesIO) -> tuple[bytes, Directories]:
    """Return the EXIF of an opened photograph, mended, and what is in it. Raises one of `UNREADABLE`."""
    if image.format == "TIFF" and isinstance(source, Path):
        directories = _of_file(source) or blocks.contents(image.getexif())  # of 64 bits
        return put_together(
            blocks.photographic(directories.image), directories.shot, directories.gps
        ), directories
    if "exif" not in image.info and image.format == "PNG":
        image.getexif()  # it may come behind the pixels
    block = bytearray(image.info.get("exif", b""))
    while block.startswith(blocks.PREFIX):
        del block[: len(blocks.PREFIX)]
    if block:
        directories = take_apart(block)  # which mends it
        if (turned := heic.orientation_of(image, source)) != 1:
            set_orientation(block, turned)
            directories.image[Tag.ORIENTATION] = turned
        return bytes(block), directories
    if not image.getexif():
        return b"", Directories()
    directories = blocks.contents(image.getexif())  # in no block of its own, as the text of a PNG
    return put_together(directories.image, directories.shot, directories.gps), directories


def _problem(lost: int) -> str:
    return f"{lost} tags of its EXIF are broken" if lost else ""


def _unreadable(error: BaseException) -> str:
    return f"EXIF not readable: {error or type(error).__name__}"


def _pages(image: Image.Image) -> int:
    """Return the number of pages of a TIFF, without broken ones; 1 for a JPEG, whose second picture is its preview."""
    try:
        return int(getattr(image, "n_frames", 1)) if image.format == "TIFF" else 1
    except _UNREADABLE:
        return 1


def _read_raw(path: Path) -> Metadata:
    """Read a RAW file's own directories; else its preview, where Fujifilm's RAF keeps them; and by LibRaw, which knows
    makers' older formats, what is still missing."""
    metadata = Metadata(problem=_NO_EXIF)
    try:
        directories = _of_file(path)
        if directories is not None:
            metadata = describe(_raw_block(directories), Metadata(problem=_problem(directories.lost)))
    except UNREADABLE as error:
        metadata = Metadata(problem=_unreadable(error))
    with suppress(PhotographError):  # whoever develops it will say so
        if not metadata.make and not metadata.focal_mm:
            metadata = _of_preview(preview_of(path)) or metadata
        if not metadata.focal_mm:
            metadata = _with_noted(metadata, libraw_metadata(path))
    return metadata


def _of_preview(preview: bytes) -> Metadata | None:
    if not preview:
        return None
    metadata = replace(_read_coded(BytesIO(preview)), profile="sRGB")
    return metadata if metadata.make or metadata.focal_mm else None


def _of_file(path: Path) -> Directories | None:
    """Return the directories of a file of TIFF's kind, as most RAW files are, or a CR3; None for another."""
    with path.open("rb") as handle, mmap(handle.fileno(), 0, access=ACCESS_COPY) as file:
        if file[4:12] == cr3.BRAND:
            image, shot, gps = (take_apart(bytearray(b)) if b else Directories() for b in cr3.blocks_of(file))
            return Directories(image.image, shot.image, gps.image, image.lost + shot.lost + gps.lost)
        if file[:2] not in (b"II", b"MM") or file[:4] in _BIG_TIFF:
            return None
        # Olympus and Panasonic have numbers of their own where TIFF has 42.
        file[:4] = _TIFF[0] if file[:2] == b"II" else _TIFF[1]
        return take_apart(file)


def _raw_block(directories: Directories) -> bytes:
    elsewhere = {ours: directories.image.get(theirs, "") for theirs, ours in _OF_DNG.items()}
    early = {t: v for t, v in directories.image.items() if t in _OF_THE_SHOT}
    shot = {t: v for t, v in (elsewhere | early | directories.shot).items() if v != ""}
    # An adapted lens says 0 mm: no information, and COLMAP would take it for some.
    shot = {t: v for t, v in shot.items() if t not in _NEVER_ZERO or number(v)}
    return put_together(blocks.photographic(directories.image), shot, directories.gps)


def _with_noted(metadata: Metadata, noted: LibrawMetadata) -> Metadata:
    """Return the metadata with what LibRaw found, where the photograph's EXIF does not say it."""
    directories = take_apart(bytearray(metadata.exif)) if metadata.exif else Directories()
    lengths = (noted.exposure_s, noted.f_number, noted.iso, noted.focal_mm)
    new: blocks.Tags = {t: blocks.rational(v) for t, v in zip(_NEVER_ZERO, lengths, strict=False) if v > 0}
    if Tag.ISO in new:
        new[Tag.ISO] = round(noted.iso)
    new |= {Tag.LENS: blocks.text(noted.lens), Tag.LENS_MAKE: blocks.text(noted.lens_make)}
    new = {tag: value for tag, value in new.items() if value and tag not in directories.shot}
    if Tag.FOCAL_LENGTH not in new:
        return metadata
    block = put_together(directories.image, directories.shot | new, directories.gps)
    problem = "" if metadata.problem == _NO_EXIF else metadata.problem
    return describe(block, replace(metadata, problem=problem))


def _text(value: Any) -> str:
    """Return text, as UTF-8 where it is, and cut at its end, as cameras fill up fields of fixed length."""
    if not isinstance(value, str):
        return ""
    plain = value.partition("\x00")[0].strip()
    try:
        return plain.encode("latin-1").decode()
    except UnicodeError:
        return plain
