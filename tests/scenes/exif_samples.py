"""Photographs with every tag that a survey wants to keep, of each kind; read back by exifread, which we do not use."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import exifread
import numpy as np
from dngs import write_kind
from PIL import Image
from PIL.TiffImagePlugin import IFDRational as R

from colmap_ihe.photographs.exif.blocks import PREFIX

SIZE = (96, 64)
IMAGE: dict[int, Any] = {
    0x010E: "north portal", 0x010F: "Canon", 0x0110: "Canon EOS 5D", 0x0112: 6, 0x0131: "Firmware 1.1.1",
    0x0132: "2016:06:21 10:00:00", 0x013B: "A. Surveyor", 0x8298: "CC0",
}  # fmt: skip
SHOT: dict[int, Any] = {
    # exposure
    0x829A: R(1, 125), 0x829D: R(8), 0x8822: 2, 0x8827: 200, 0x9204: R(-1, 3),
    # dates, their offset from UTC, and their parts of a second
    0x9003: "2016:06:21 10:00:00", 0x9004: "2016:06:21 10:00:01",
    0x9010: "+02:00", 0x9011: "+02:00", 0x9012: "+02:00", 0x9290: "10", 0x9291: "11", 0x9292: "12",
    # focal length, focal plane
    0x920A: R(24), 0xA405: 24, 0xA002: 96, 0xA003: 64, 0xA20E: R(9600, 36), 0xA20F: R(6400, 24), 0xA210: 3,
    # camera and lens
    0xA431: "0123", 0xA432: (R(24), R(70), R(28, 10), R(0, 0)), 0xA433: "Canon", 0xA434: "EF 24-70",
}  # fmt: skip
GPS: dict[int, Any] = {
    0: b"\x02\x03\x00\x00", 1: "S", 2: (R(48), R(46), R(265, 10)), 3: "W", 4: (R(2), R(17), R(491, 10)), 5: b"\x01",
    6: R(855, 10), 7: (R(10), R(11), R(12)), 11: R(2), 16: "T", 17: R(1234, 10), 18: "WGS-84", 29: "2016:06:21",
    31: R(5),
}  # fmt: skip
EVERY_TAG = {("Image", t) for t in IMAGE} | {("EXIF", t) for t in SHOT} | {("GPS", t) for t in GPS}


def block(image: dict[int, Any], shot: dict[int, Any], gps: dict[int, Any]) -> Image.Exif:
    """For `Image.save(exif=...)` of any kind of file."""
    filled = Image.Exif()
    filled.update(image)
    filled.get_ifd(0x8769).update(shot)
    filled.get_ifd(0x8825).update(gps)
    read = Image.Exif()  # from bytes: Pillow writes directories that were filled by hand to JPEG only
    read.load(filled.tobytes())
    return read


def full_photograph(path: Path) -> Path:
    """By its suffix: .jpg, .png, .tif, .dng, or .orf, which is a TIFF with Olympus's own mark."""
    if path.suffix in (".dng", ".orf"):
        _write_raw(path)
    else:
        Image.new("RGB", SIZE, (90, 100, 110)).save(path, exif=block(IMAGE, SHOT, GPS))
    return path


def _write_raw(path: Path) -> None:
    pixels, tags = np.full(SIZE[::-1], 700, np.uint16), {**IMAGE, 0x8769: SHOT, 0x8825: GPS}
    write_kind(path, pixels, pattern=np.array([["R", "G"], ["G", "B"]]), black=(512,), white=16383, tags=tags)
    if path.suffix == ".orf":
        path.write_bytes(b"IIRO" + path.read_bytes()[4:])


def tags_of(path: Path) -> dict[tuple[str, int], str]:
    """Values in words by directory and number, as exifread finds them."""
    with path.open("rb") as handle:
        found = exifread.process_file(handle, details=False)
    tags = [(name, tag) for name, tag in found.items() if hasattr(tag, "tag")]
    return {(name.partition(" ")[0], tag.tag): str(tag.values) for name, tag in tags}


_CANON = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")


def _structure(tags: dict[int, Any]) -> bytes:
    """A TIFF structure with these tags in its first and only directory."""
    block = Image.Exif()
    block.update(tags)
    return block.tobytes().removeprefix(PREFIX)


def _box(kind: bytes, *content: bytes, large: bool = False) -> bytes:
    inside = b"".join(content)
    if large:
        return struct.pack(">L4sQ", 1, kind, 16 + len(inside)) + inside
    return struct.pack(">L4s", 8 + len(inside), kind) + inside


def cr3(large: bool = False) -> bytes:
    """A Canon CR3 of nothing but boxes; `large`: with lengths of 64 bits."""
    tags = {t: v for t, v in GPS.items() if t not in (0, 5)}  # whose types Pillow knows below GPS only
    blocks = [
        _box(b"CMT1", _structure(IMAGE)),
        _box(b"CMT2", _structure(SHOT)),
        _box(b"CMT3", b"Canon's own"),
        _box(b"CMT4", _structure(tags)),
    ]
    uuid = _box(b"uuid", _CANON, _box(b"CNCV", b"CanonCR3_001"), *blocks, large=large)
    movie = _box(b"moov", _box(b"uuid", bytes(16), b"another"), uuid, _box(b"trak", bytes(40)))
    return _box(b"ftyp", b"crx ", bytes(4)) + movie + _box(b"mdat", bytes(100))
