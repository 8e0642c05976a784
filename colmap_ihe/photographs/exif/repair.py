"""TIFF structures, which EXIF is, made sound: what cannot be read is taken out, nothing else moves."""

from __future__ import annotations

import struct
from mmap import mmap

from PIL import TiffTags

_ORDERS = {b"II": "<", b"MM": ">"}
# Bytes of one value by type: TIFF 6.0, with 13 of its supplement and 129 (UTF-8) of Exif 3.0.
_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 129: 1}
_NUMBERS = frozenset({3, 4, 5, 6, 8, 9, 10, 11, 12, 13})
_DIRECTORIES = frozenset(
    {0x8769, 0x8825, 0xA005}
)  # tags that hold the place of one: EXIF, GPS, interoperability
_ENTRY = 12
_PASSES = 8  # directories that overlap can spoil each other as they are mended


def mend(block: bytearray | mmap) -> int:
    """Take out, in place, the entries of a TIFF structure that are of no known type, lie outside it, are many where
    there is one, or share their places; and a thumbnail that is broken or follows a broken directory.

    Whatever else is there stays where it was, since maker notes hold offsets. Returns how many were taken out.
    Raises ValueError where there is no such structure.
    """
    order = _ORDERS.get(bytes(block[:2]))
    if order is None or len(block) < 8:
        raise ValueError("no TIFF structure")
    lost = 0
    for _ in range(_PASSES):
        more = _mend_all(block, order)
        if not more:
            return lost
        lost += more
    raise ValueError("a TIFF structure whose directories overlap")


def _mend_all(block: bytearray | mmap, order: str) -> int:
    (first,) = struct.unpack_from(f"{order}L", block, 4)
    seen: set[int] = set()
    lost = _mend_directory(block, order, first, 0, seen)
    if lost is None:
        raise ValueError("a TIFF structure without a directory")
    end = first + 2 + _ENTRY * struct.unpack_from(f"{order}H", block, first)[0]
    (thumbnail,) = struct.unpack_from(f"{order}L", block, end)
    if thumbnail and _mend_directory(block, order, thumbnail, 0, seen) is None:
        struct.pack_into(f"{order}L", block, end, 0)
    return lost


def _mend_directory(
    block: bytearray | mmap, order: str, start: int, group: int, seen: set[int]
) -> int | None:
    """Return how many entries were taken out of the directory at `start`; None where there is none."""
    if start in seen or start < 8 or start + 2 > len(block):
        return None
    seen.add(start)
    (count,) = struct.unpack_from(f"{order}H", block, start)
    room = (len(block) - start - 2) // _ENTRY
    lost: int = max(0, count - room)
    sound = []
    far = 0  # bytes outside the directory: where they are more than there can be, values share their places
    for entry in range(start + 2, start + 2 + _ENTRY * min(count, room), _ENTRY):
        tag, kind, values, at = struct.unpack_from(f"{order}HHLL", block, entry)
        size = values * _BYTES.get(kind, 0)
        good = far + size <= len(block) and _is_sound(block, tag, kind, values, at, group)
        if good and tag in _DIRECTORIES:
            inner = _mend_directory(block, order, at, tag, seen)
            good, lost = inner is not None, lost + (inner or 0)
        if good:
            sound.append(bytes(block[entry : entry + _ENTRY]))
            far += size if size > 4 else 0
        else:
            lost += 1
    end = start + 2 + _ENTRY * len(sound)
    if end + 4 > len(block) and isinstance(block, bytearray):
        block.extend(bytes(4))  # some writers leave out the place of the next directory
    elif end + 4 > len(block):
        return None
    if len(sound) < count:
        struct.pack_into(f"{order}H", block, start, len(sound))
        block[start + 2 : end + 4] = b"".join(sound) + bytes(4)
    return lost


def _is_sound(block: bytearray | mmap, tag: int, kind: int, values: int, at: int, group: int) -> bool:
    size = values * _BYTES.get(kind, 0)
    if kind not in _BYTES or (size > 4 and at + size > len(block)):
        return False
    if tag in _DIRECTORIES:
        return kind in (4, 13) and values == 1
    return values == 1 or kind not in _NUMBERS or bool(TiffTags.lookup(tag, group or None).length != 1)
