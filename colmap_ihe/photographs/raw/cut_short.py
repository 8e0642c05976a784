"""RAW files that end before their pixels do: LibRaw decodes what memory held before in their place, without a word.

Where the pixels lie is said by the directories of files of TIFF's kind (TIFF 6.0: strips and tiles; Panasonic's
RawDataOffset), by the header of Fujifilm's RAF, and by the boxes of Canon's CR3 (ISO 14496-12).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_process import BROKEN

_SUB_IFDS, _RAW_DATA = 0x014A, 0x0118
_PLACES = ((0x0111, 0x0117), (0x0144, 0x0145), (_RAW_DATA, 0x0117))  # offsets and lengths in bytes
_FORMATS = {1: "B", 3: "H", 4: "I", 13: "I"}  # of TIFF's unsigned numbers
_MOST_DIRECTORIES, _MOST_ENTRIES, _MOST_VALUES = 64, 1024, 1 << 16  # more is a hostile file
_NOWHERE = 0xFFFFFFFF  # Panasonic's offset of strips that RawDataOffset takes the place of
_SLACK = 4096  # bytes: makers round lengths up


def refuse_cut_short(path: Path) -> None:
    """Raise `PhotographError` for a RAW file that ends before the place that its header names as the end of its
    pixels; of formats that do not say it, nothing is known. Raises OSError."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        try:
            end = max(_ends(file, size), default=0)
        except (struct.error, OverflowError):  # a header that is cut itself is LibRaw's to refuse
            return
    if end > size + _SLACK:
        raise PhotographError(
            f"{path.name}: ends at byte {size:,}, and its header says that its pixels end at {end:,}: it was cut"
            " short",
            hint=BROKEN,
        )


def _ends(file: BinaryIO, size: int) -> Iterator[int]:
    """Yield the bytes at which parts of the pixels end."""
    head = _at(file, 0, 108)
    if head.startswith(b"FUJIFILM"):
        offset, length = struct.unpack(">2I", head[100:108])
        yield offset + length
    elif head[4:8] == b"ftyp":
        yield from _ends_of_boxes(file, size)
    elif head[:2] in (b"II", b"MM"):
        yield from _ends_of_directories(file, "<" if head[:2] == b"II" else ">", head)


def _at(file: BinaryIO, offset: int, count: int) -> bytes:
    file.seek(offset)
    return file.read(count)


def _ends_of_boxes(file: BinaryIO, size: int) -> Iterator[int]:
    offset = 0
    for _ in range(_MOST_DIRECTORIES):
        if offset >= size:
            return
        length = struct.unpack(">I", _at(file, offset, 4))[0]
        if length == 1:
            length = struct.unpack(">Q", _at(file, offset + 8, 8))[0]
        if length < 8:  # 0: to the end of the file, wherever that is
            return
        offset += length
        yield offset


def _ends_of_directories(file: BinaryIO, order: str, head: bytes) -> Iterator[int]:
    """Yield them of all directories, those within others too, each once."""
    waiting: list[int] = [struct.unpack(order + "I", head[4:8])[0]]
    seen: set[int] = set()
    while waiting and len(seen) < _MOST_DIRECTORIES:
        offset = waiting.pop()
        if not offset or offset in seen:
            continue
        seen.add(offset)
        count = min(struct.unpack(order + "H", _at(file, offset, 2))[0], _MOST_ENTRIES)
        entries = _at(file, offset + 2, 12 * count + 4)
        tags = {}
        for start in range(0, 12 * count, 12):
            tag, kind, number = struct.unpack(order + "HHI", entries[start : start + 8])
            tags[tag] = (kind, number, entries[start + 8 : start + 12])
        read = _reader(file, order, tags)
        for offsets, lengths in _PLACES:
            yield from (o + n for o, n in zip(read(offsets), read(lengths), strict=False) if o != _NOWHERE)
        waiting += [*read(_SUB_IFDS), *struct.unpack(order + "I", entries[12 * count :].ljust(4, b"\0")[:4])]


def _reader(
    file: BinaryIO, order: str, tags: dict[int, tuple[int, int, bytes]]
) -> Callable[[int], tuple[int, ...]]:
    """Return what reads the numbers of a tag of one directory; none where it is not there, or no number."""

    def read(tag: int) -> tuple[int, ...]:
        kind, number, inline = tags.get(tag, (0, 0, b""))
        letter = _FORMATS.get(kind)
        if letter is None or number > _MOST_VALUES:
            return ()
        layout = f"{order}{number}{letter}"
        length = struct.calcsize(layout)
        content = inline if length <= 4 else _at(file, struct.unpack(order + "I", inline)[0], length)
        return struct.unpack(layout, content[:length])

    return read
