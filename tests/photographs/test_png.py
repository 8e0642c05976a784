"""PNG files that we write, and read again."""

from __future__ import annotations

import zlib
from io import BytesIO

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.photographs.png import Png, decode_png, encode_png

EXIF = b"MM\x00*\x00\x00\x00\x08\x00\x00"
PROFILE = bytes(range(200))


def picture(*shape: int) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("shape", [(7, 5), (7, 5, 3), (7, 5, 4), (1, 1)])
def test_a_file_has_what_was_written(shape: tuple[int, ...]) -> None:
    pixels = picture(*shape)
    content = encode_png(pixels, EXIF, PROFILE)
    assert np.array_equal(np.asarray(Image.open(BytesIO(content))), pixels)
    png = decode_png(content)
    assert isinstance(png, Png)
    assert np.array_equal(png.pixels, pixels)
    assert (png.exif, png.profile) == (EXIF, PROFILE)


def test_a_damaged_file_is_none_of_ours() -> None:
    content = encode_png(picture(20, 30), EXIF)
    assert all(decode_png(content[:end]) is None for end in range(0, len(content) - 1, 7))
    at = content.index(b"IDAT") + 60
    assert decode_png(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]) is None


@pytest.mark.parametrize("mode", ["L", "RGB", "P", "1", "I;16"])
def test_a_file_of_another_writer_is_left_to_others(mode: str) -> None:
    buffer = BytesIO()
    Image.fromarray(np.tile(np.arange(40, dtype=np.uint8), (30, 1))).convert(mode).save(buffer, "PNG")
    assert decode_png(buffer.getvalue()) is None


def test_a_small_file_that_claims_to_be_large_takes_no_memory() -> None:
    content = bytearray(encode_png(picture(2, 2)))
    content[16:24] = (60_000).to_bytes(4, "big") * 2
    content[29:33] = zlib.crc32(content[12:29]).to_bytes(4, "big")
    assert decode_png(bytes(content)) is None
