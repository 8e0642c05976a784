"""RAW files that end before their pixels do are refused, whatever their maker."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from dngs import shoot

from colmap_ihe.errors import PhotographError
from colmap_ihe.photographs.raw.cut_short import refuse_cut_short
from colmap_ihe.photographs.raw.develop import read_header

PIXELS = 50_000  # bytes


def directory(magic: bytes, order: str, *entries: tuple[int, int]) -> bytes:
    """A file of TIFF's kind with one directory of 32-bit numbers, then the pixels."""
    body = b"".join(struct.pack(f"{order}HHII", tag, 4, 1, value) for tag, value in entries)
    return magic + struct.pack(f"{order}IH", 8, len(entries)) + body + bytes(4)


def tiff(magic: bytes, order: str, offset_tag: int = 0x0111, *more: tuple[int, int]) -> bytes:
    count = 2 + len(more)
    start = 8 + 2 + 12 * count + 4
    return directory(magic, order, *more, (0x0117, PIXELS), (offset_tag, start)) + bytes(PIXELS)


def raf() -> bytes:
    return b"FUJIFILMCCD-RAW ".ljust(100, b"\0") + struct.pack(">2I", 108, PIXELS) + bytes(PIXELS)


def cr3(large: bool) -> bytes:
    size = (
        struct.pack(">I4sQ", 1, b"mdat", PIXELS + 16) if large else struct.pack(">I4s", PIXELS + 8, b"mdat")
    )
    return struct.pack(">I4s", 16, b"ftyp") + b"crx \0\0\0\1" + size + bytes(PIXELS)


FILES = {
    "nef": tiff(b"MM\0*", ">"),
    "orf": tiff(b"IIRO", "<"),
    "rw2": tiff(b"IIU\0", "<", 0x0118, (0x0111, 0xFFFFFFFF)),
    "tiles.dng": directory(b"II*\0", "<", (0x0145, PIXELS), (0x0144, 38)) + bytes(PIXELS),
    "raf": raf(),
    "cr3": cr3(large=False),
    "large.cr3": cr3(large=True),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_ends_before_its_pixels_is_refused(tmp_path: Path, kind: str) -> None:
    file = tmp_path / f"a.{kind}"
    file.write_bytes(FILES[kind])
    refuse_cut_short(file)
    file.write_bytes(FILES[kind][: len(FILES[kind]) * 4 // 10])
    with pytest.raises(
        PhotographError, match=rf"ends at byte .* end at {len(FILES[kind]):,}: it was cut short"
    ):
        refuse_cut_short(file)


def test_pixels_of_a_directory_within_another_count(tmp_path: Path) -> None:
    inner = 8 + 2 + 12 + 4
    outer = directory(b"II*\0", "<", (0x014A, inner))
    body = struct.pack("<HHHIIHHIII", 2, 0x0111, 4, 1, 100, 0x0117, 4, 1, PIXELS, 0)
    (tmp_path / "a.dng").write_bytes(outer + body)
    with pytest.raises(PhotographError, match=f"its pixels end at {100 + PIXELS:,}"):
        refuse_cut_short(tmp_path / "a.dng")


@pytest.mark.parametrize(
    "content", [b"", b"II", b"II*\0\x08\0\0\0", b"\0\0\0\0ftyp", b"MM\0*" + b"\xff" * 300]
)
def test_what_is_no_header_is_left_to_libraw(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.dng").write_bytes(content)
    refuse_cut_short(tmp_path / "a.dng")


def test_directories_that_name_themselves_come_to_an_end(tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(directory(b"II*\0", "<", (0x014A, 8), (0x0111, 8), (0x0117, 4)))
    refuse_cut_short(tmp_path / "a.dng")


def test_the_header_of_a_cut_file_is_refused_at_once(tmp_path: Path) -> None:
    shoot(tmp_path / "a.dng", np.full((480, 640), 6000, np.uint16))
    content = (tmp_path / "a.dng").read_bytes()
    (tmp_path / "a.dng").write_bytes(content[: len(content) // 2])
    with pytest.raises(PhotographError, match=r"a\.dng: ends at byte"):
        read_header(tmp_path / "a.dng")


@pytest.mark.data
@pytest.mark.parametrize("name", ["colorchart.dng", "kodak_dc50.kdc"])
def test_whole_files_of_cameras_are_whole(photographs: Path, name: str) -> None:
    refuse_cut_short(photographs / "raw" / name)
