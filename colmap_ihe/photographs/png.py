"""PNG files, written without zlib, and read again in half of the time that other readers take.

pycolmap carries zlib symbols of its own. In a process that imported pycolmap before anything that uses the
system's zlib, every PNG writer that does so (OpenCV, Pillow, Python's zlib module) corrupts memory and
aborts. Our user's script may well import pycolmap first, so compression is ISA-L's, whose symbols are its
own. It is also seven times faster than Pillow at the same size.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

_COLOUR_TYPE = {1: 0, 3: 2, 4: 6}  # by the number of channels: grey, RGB, RGB with alpha
_FILTER_UP = 2
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Png:
    """Hold what `encode_png` was given: `pixels` uint8, (H, W) grey, (H, W, 3) RGB or (H, W, 4) with alpha, `exif` and
    `profile`."""

    pixels: NDArray[np.uint8]
    exif: bytes
    profile: bytes


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
    parts = [_SIGNATURE, *_chunk(b"IHDR", header)]
    if profile:
        parts += _chunk(b"iCCP", b"ICC profile\x00\x00" + isal_zlib.compress(profile, 1))
    if exif:
        parts += _chunk(b"eXIf", exif)
    parts += [*_chunk(b"IDAT", isal_zlib.compress(filtered, 1)), *_chunk(b"IEND", b"")]
    return b"".join(parts)  # once: to copy holds up the other threads


def _chunk(kind: bytes, content: bytes) -> tuple[bytes, ...]:
    checksum = isal_zlib.crc32(content, isal_zlib.crc32(kind))
    return struct.pack(">I", len(content)), kind, content, struct.pack(">I", checksum)


def decode_png(content: bytes) -> Png | None:
    """Return what a file of `encode_png` holds, None where the file is damaged or another writer's.

    Other threads go on meanwhile, which they do not beside COLMAP's reader.
    """
    try:
        chunks = list(_chunks(content))
        kinds, held = [name for name, _ in chunks], {name: bytes(part) for name, part in chunks}
        if kinds[0] != b"IHDR" or kinds[-1] != b"IEND" or kinds.count(b"IDAT") != 1:
            return None
        pixels = _pixels(held[b"IHDR"], held[b"IDAT"])
        profile = held.get(b"iCCP", b"").partition(b"\x00\x00")[2]
        profile = isal_zlib.decompress(profile) if profile else b""
    except (KeyError, ValueError, struct.error, isal_zlib.IsalError):  # type: ignore[misc]
        return None
    return Png(pixels, held.get(b"eXIf", b""), profile)


def _pixels(header: bytes, packed: bytes) -> NDArray[np.uint8]:
    """Return the pixels of a file. Raises ValueError where it is not one of `encode_png`."""
    width, height, *kind = struct.unpack(">IIBBBBB", header)
    channels = {colour_type: number for number, colour_type in _COLOUR_TYPE.items()}.get(kind[1], 0)
    row = width * channels + 1
    # no compression makes more than 1,032 bytes of one
    if kind != [8, kind[1], 0, 0, 0] or row == 1 or not 0 < height * row < len(packed) << 11:
        raise ValueError("another kind of PNG file")
    filtered = np.frombuffer(isal_zlib.decompress(packed, bufsize=height * row), np.uint8).reshape(
        height, row
    )
    if (filtered[:, 0] != _FILTER_UP).any():
        raise ValueError("rows with another filter")
    pixels = np.empty((height, row - 1), np.uint8)
    pixels[0] = filtered[0, 1:]
    for above, below, difference in zip(pixels[:-1], pixels[1:], filtered[1:, 1:], strict=True):
        np.add(above, difference, out=below)
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


def _chunks(content: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Yield name and content of each chunk. Raises ValueError and `struct.error` where they do not hold together."""
    if not content.startswith(_SIGNATURE):
        raise ValueError("no PNG file")
    start, view = len(_SIGNATURE), memoryview(content)
    while start < len(content):
        length, name = struct.unpack_from(">I4s", content, start)
        held = view[start + 8 : start + 8 + length]
        (checksum,) = struct.unpack_from(">I", content, start + 8 + length)
        if checksum != isal_zlib.crc32(held, isal_zlib.crc32(name)):
            raise ValueError(f"the chunk {name!r} is damaged")
        yield name, held
        start += length + 12
