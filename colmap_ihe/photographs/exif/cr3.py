"""Canon's CR3: an ISO base media file that keeps EXIF as TIFF structures in boxes of its own.

After https://github.com/lclevy/canon_cr3: in `moov`, in the `uuid` box below, CMT1 is the first directory,
CMT2 that of the shot, CMT4 that of GPS.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from mmap import mmap

BRAND = b"ftypcrx "
"""At byte 4 of a file."""

_CANON = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
_BLOCKS = (b"CMT1", b"CMT2", b"CMT4")


def blocks_of(file: mmap) -> list[bytes]:
    """Return the TIFF structures of image, shot and GPS, empty for one that is not there."""
    blocks = dict.fromkeys(_BLOCKS, b"")
    for kind, start, end in _boxes(file, 0, len(file)):
        if kind != b"moov":
            continue
        for inner, inner_start, inner_end in _boxes(file, start, end):
            if inner != b"uuid" or file[inner_start : inner_start + 16] != _CANON:
                continue
            for name, first, last in _boxes(file, inner_start + 16, inner_end):
                if name in blocks:
                    blocks[name] = file[first:last]
    return list(blocks.values())


def _boxes(file: mmap, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the kind of each box, and where its content starts and ends (ISO/IEC 14496-12, 4.2)."""
    while start + 8 <= end:
        size, kind = struct.unpack_from(">L4s", file, start)
        header = 8
        if size == 1 and start + 16 <= end:
            (size,) = struct.unpack_from(">Q", file, start + 8)
            header = 16
        last = end if size == 0 else start + size
        if last > end or last < start + header:
            return
        yield kind, start + header, last
        start = last
