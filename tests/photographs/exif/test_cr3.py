"""Canon's CR3 keeps EXIF in boxes of its own. Files made here, after its description: there is no camera at hand."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from exif_samples import GPS, IMAGE, SHOT
from PIL import Image

from colmap_ihe.photographs.exif.blocks import PREFIX, take_apart
from colmap_ihe.photographs.exif.metadata import read_metadata

CANON = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")


def structure(tags: dict[int, Any]) -> bytes:
    """A TIFF structure with these tags in its first and only directory."""
    block = Image.Exif()
    block.update(tags)
    return block.tobytes().removeprefix(PREFIX)


def box(kind: bytes, *content: bytes, large: bool = False) -> bytes:
    inside = b"".join(content)
    if large:
        return struct.pack(">L4sQ", 1, kind, 16 + len(inside)) + inside
    return struct.pack(">L4s", 8 + len(inside), kind) + inside


def cr3(large: bool = False) -> bytes:
    tags = {t: v for t, v in GPS.items() if t not in (0, 5)}  # whose types Pillow knows below GPS only
    blocks = [
        box(b"CMT1", structure(IMAGE)),
        box(b"CMT2", structure(SHOT)),
        box(b"CMT3", b"Canon's own"),
        box(b"CMT4", structure(tags)),
    ]
    uuid = box(b"uuid", CANON, box(b"CNCV", b"CanonCR3_001"), *blocks, large=large)
    movie = box(b"moov", box(b"uuid", bytes(16), b"another"), uuid, box(b"trak", bytes(40)))
    return box(b"ftyp", b"crx ", bytes(4)) + movie + box(b"mdat", bytes(100))


@pytest.mark.parametrize("large", [False, True])
def test_the_boxes_are_found(tmp_path: Path, large: bool) -> None:
    (tmp_path / "a.cr3").write_bytes(cr3(large))
    found = read_metadata(tmp_path / "a.cr3", "raw")
    assert (found.make, found.model, found.focal_mm, found.focal_35mm) == ("Canon", "Canon EOS 5D", 24, 24)
    assert (found.orientation, found.lens, found.has_gps, found.problem) == (6, "EF 24-70", True, "")
    left = take_apart(bytearray(found.exif))
    assert (set(left.shot), set(left.image) - {0x8769, 0x8825}) == (set(SHOT), set(IMAGE))


def test_broken_boxes_are_no_reason_to_fail(tmp_path: Path) -> None:
    whole = cr3()
    makes = set()
    for cut in range(12, len(whole), 7):
        (tmp_path / "a.cr3").write_bytes(whole[:cut])
        makes.add(read_metadata(tmp_path / "a.cr3", "raw").make)
        holed = whole[:cut] + b"\xff\xff\xff\xff" + whole[cut + 4 :]
        (tmp_path / "a.cr3").write_bytes(holed)
        makes.add(read_metadata(tmp_path / "a.cr3", "raw").make)
    assert makes >= {"", "Canon"}
