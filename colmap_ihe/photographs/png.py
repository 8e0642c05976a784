"""PNG files, written without zlib.

pycolmap carries zlib symbols of its own. In a process that imported pycolmap before anything that uses the
system's zlib, every PNG writer that does so (OpenCV, Pillow, Python's zlib module) corrupts memory and
aborts. Our user's script may well import pycolmap first, so compression is ISA-L's, whose symbols are its
own. It is also seven times faster than Pillow at the same size.
"""

from __future__ import annotations

import struct

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

_COLOUR_TYPE = {1: 0, 3: 2, 4: 6}  # by the number of channels: grey, RGB, RGB with alpha
_FILTER_UP = 2


def encode_png(pixels: NDArray[np.uint8], exif: bytes = b"", profile: bytes = b"") -> bytes:
    """Return an 8-bit PNG file: pixels (H, W) grey, (H, W, 3) RGB or (H, W, 4) with alpha; `exif` is a TIFF structure,
    `profile` an ICC profile, either may be empty.

    After the PNG specification (third edition): rows filtered by "up", EXIF in an eXIf chunk. Raises
    ValueError on another shape or dtype.
    """
    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or (pixels.ndim == 3 and channels not in (3, 4)):
        raise ValueError(f"{pixels.shape=} {pixels.dtype=}, expected (H, W), (H, W, 3) or (H, W, 4) uint8")
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    filtered = np.empty((height, rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = _FILTER_UP
    filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, 8, _COLOUR_TYPE[channels], 0, 0, 0)
    parts = [b"\x89PNG\r\n\x1a\n", *_chunk(b"IHDR", header)]
    if profile:
        parts += _chunk(b"iCCP", b"ICC profile\x00\x00" + isal_zlib.compress(profile, 1))
    if exif:
        parts += _chunk(b"eXIf", exif)
    parts += [*_chunk(b"IDAT", isal_zlib.compress(filtered, 1)), *_chunk(b"IEND", b"")]
    return b"".join(parts)  # once: to copy holds up the other threads


def _chunk(kind: bytes, content: bytes) -> tuple[bytes, ...]:
    checksum = isal_zlib.crc32(content, isal_zlib.crc32(kind))
    return struct.pack(">I", len(content)), kind, content, struct.pack(">I", checksum)
