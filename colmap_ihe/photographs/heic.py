"""HEIC and HEIF photographs, as phones write them: how they were turned, which the library takes back."""

from __future__ import annotations

import re
from functools import cache
from io import BytesIO
from pathlib import Path

from PIL import Image

_HEAD_BYTES = 1 << 20  # of the boxes before the pixels
_TURNS = {6: 3, 8: 1, 3: 2}
"""By the Orientation tag of EXIF, the quarters anticlockwise of the box `irot` that ask for the same (ISO 23008-12)."""


@cache
def register() -> None:
    """Have Pillow open HEIC files. Photographs are what is parallel: one thread each."""
    import pi_heif  # in the processes that decode only

    pi_heif.register_heif_opener(decode_threads=1, thumbnails=False, depth_images=False, aux_images=False)


def orientation_of(image: Image.Image, source: Path | BytesIO) -> int:
    """Return the Orientation tag that goes with the pixels as the sensor had them, of an opened image.

    The library returns pixels upright, by the boxes `irot` and `imir`, and sets the tag in `image.info` to 1. Where tag
    and box agree the turn can be taken back; where they do not only the box counts, and the pixels stay upright: 1.
    """
    if image.format != "HEIF":
        return 1
    head = _head(source)
    tag = image.info.get("original_orientation") or 1
    angles = {quarters[0] & 3 for quarters in re.findall(rb"\0\0\0\x09irot(.)", head, re.DOTALL)}
    return tag if angles == {_TURNS.get(tag)} and b"imir" not in head else 1


def _head(source: Path | BytesIO) -> bytes:
    if isinstance(source, BytesIO):
        return source.getvalue()[:_HEAD_BYTES]
    with source.open("rb") as file:
        return file.read(_HEAD_BYTES)
