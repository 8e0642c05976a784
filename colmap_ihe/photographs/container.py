"""Change what stands around the pixels of a PNG or TIFF in memory, so that it costs no decoder the pixels."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

_PNG = b"\x89PNG\r\n\x1a\n"
_TEXT = (b"tEXt", b"zTXt", b"iTXt")
_AROUND = 12  # bytes of a chunk besides its content: length, type, checksum
_ORIENTATION, _SHORT = 274, 3  # TIFF 6.0: the tag, and its type
_BIG = 43  # where a plain TIFF has 42
_MOST_ENTRIES = 1 << 16


def without_text(file: BinaryIO) -> BinaryIO:
    """Return a PNG without its text, which Pillow bounds, at the cost of the photograph; the file itself, at its
    beginning, if it holds none or is no PNG."""
    chunks = _text_chunks(file)
    file.seek(0)
    if not chunks:
        return file
    content = bytearray(file.read())
    for start, size in reversed(chunks):
        del content[start : start + size]
    return BytesIO(content)


def _text_chunks(file: BinaryIO) -> list[tuple[int, int]]:
    """Return place and size of each chunk of text, as far as the file is sound."""
    file.seek(0)
    found: list[tuple[int, int]] = []
    if file.read(len(_PNG)) != _PNG:
        return found
    at = len(_PNG)
    while len(head := file.read(8)) == 8 and head[4:] != b"IEND":
        size = int.from_bytes(head[:4], "big") + _AROUND
        if head[4:] in _TEXT:
            found.append((at, size))
        at += size
        file.seek(at)
    return found


def not_turned(path: Path) -> NDArray[np.uint8]:
    """Return the bytes of a file, (N,) uint8, of a TIFF with its Orientation set to 1: OpenCV fails on a 16-bit one
    that is turned. Raises OSError."""
    content = bytearray(path.read_bytes())
    set_orientation(content, 1)
    return np.frombuffer(content, np.uint8)


def set_orientation(content: bytearray, orientation: int) -> None:
    """Write the Orientation tag of a TIFF, or of a block of EXIF, in place, where it has one: nothing else moves.
    Raises OSError for one that is cut short."""
    order = {b"II": "<", b"MM": ">"}.get(bytes(content[:2]))
    if order is None:
        return
    try:
        big = struct.unpack_from(f"{order}H", content, 2)[0] == _BIG
        (first,) = struct.unpack_from(f"{order}Q" if big else f"{order}L", content, 8 if big else 4)
        (count,) = struct.unpack_from(f"{order}Q" if big else f"{order}H", content, first)
        before, size, value = (8, 20, 12) if big else (2, 12, 8)
        start = first + before
        for entry in range(start, start + size * min(count, _MOST_ENTRIES), size):
            if struct.unpack_from(f"{order}HH", content, entry) == (_ORIENTATION, _SHORT):
                struct.pack_into(f"{order}H", content, entry + value, orientation)
    except struct.error as error:
        raise OSError(f"a TIFF cut short ({error})") from error
