"""Photographs with every tag that a survey wants to keep, of each kind; read back by exifread, which we do not use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import exifread
import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational as R
from PIL.TiffImagePlugin import ImageFileDirectory_v2

SIZE = (96, 64)
IMAGE: dict[int, Any] = {
    0x010E: "north portal", 0x010F: "Canon", 0x0110: "Canon EOS 5D", 0x0112: 6, 0x0131: "Firmware 1.1.1",
    0x0132: "2016:06:21 10:00:00", 0x013B: "A. Surveyor", 0x8298: "CC0",
}  # fmt: skip
SHOT: dict[int, Any] = {
    0x829A: R(1, 125), 0x829D: R(8), 0x8822: 2, 0x8827: 200,  # exposure
    0x9003: "2016:06:21 10:00:00", 0x9004: "2016:06:21 10:00:01",  # dates,
    0x9010: "+02:00", 0x9011: "+02:00", 0x9012: "+02:00",  # their offset from UTC
    0x9290: "10", 0x9291: "11", 0x9292: "12",  # and their parts of a second
    0x9204: R(-1, 3), 0x920A: R(24), 0xA405: 24,  # focal length
    0xA002: 96, 0xA003: 64, 0xA20E: R(9600, 36), 0xA20F: R(6400, 24), 0xA210: 3,  # focal plane
    0xA431: "0123", 0xA432: (R(24), R(70), R(28, 10), R(0, 0)), 0xA433: "Canon", 0xA434: "EF 24-70",  # lens
}  # fmt: skip
GPS: dict[int, Any] = {
    0: b"\x02\x03\x00\x00", 1: "S", 2: (R(48), R(46), R(265, 10)), 3: "W", 4: (R(2), R(17), R(491, 10)),
    5: b"\x01", 6: R(855, 10), 7: (R(10), R(11), R(12)), 11: R(2), 16: "T", 17: R(1234, 10), 18: "WGS-84",
    29: "2016:06:21", 31: R(5),
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
    directory = ImageFileDirectory_v2()
    directory.update(IMAGE)
    directory[0x8769], directory[0x8825] = SHOT, GPS
    width, height = SIZE
    mosaic: list[tuple[int, int, Any]] = [
        *((254, 4, 0), (256, 4, width), (257, 4, height), (258, 3, 16), (259, 3, 1), (262, 3, 32803)),
        *((273, 4, 0), (277, 3, 1), (278, 4, height), (279, 4, 2 * width * height), (284, 3, 1)),
        *((33421, 3, (2, 2)), (33422, 1, b"\x00\x01\x01\x02"), (50714, 4, 512), (50717, 4, 16383)),
        *((50706, 1, b"\x01\x04\x00\x00"), (50708, 2, "X"), (50728, 5, (0.5, 1.0, 0.6)), (50778, 3, 21)),
        (50721, 10, tuple(np.eye(3).ravel())),
    ]
    for tag, kind, value in mosaic:
        directory.tagtype[tag] = kind
        directory[tag] = value
    mark = b"II*\0" if path.suffix == ".dng" else b"IIRO"
    pixels = np.full((height, width), 700, "<u2").tobytes()
    path.write_bytes(mark + b"\x08\0\0\0" + directory.tobytes(8) + pixels)


def tags_of(path: Path) -> dict[tuple[str, int], str]:
    """Values in words by directory and number, as exifread finds them."""
    with path.open("rb") as handle:
        found = exifread.process_file(handle, details=False)
    return {
        (name.partition(" ")[0], tag.tag): str(tag.values)
        for name, tag in found.items()
        if hasattr(tag, "tag")
    }
