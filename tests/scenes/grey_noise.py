"""Small grey images of noise, whose EXIF says of the camera what a test wants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL.TiffImagePlugin import IFDRational

from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.photographs.exif.blocks import Tag, put_together, text

WHOLE: dict[str, Any] = {"make": "Foo", "model": "Bar", "focal": 35}
"""Enough for COLMAP to tell which photographs one camera took."""


def exif(make: str = "", model: str = "", focal: float = 0, f35: int = 0) -> bytes:
    image: dict[int, Any] = {
        tag: text(value) for tag, value in ((Tag.MAKE, make), (Tag.MODEL, model)) if value
    }
    shot: dict[int, Any] = {Tag.FOCAL_LENGTH: IFDRational(focal)} if focal else {}
    return put_together(image, shot | ({Tag.FOCAL_LENGTH_35MM: f35} if f35 else {}), {})


def noise(folder: Path, name: str, size: tuple[int, int] = (90, 66), **said: Any) -> str:
    """Write a grey image with such EXIF; return its name."""
    pixels = np.random.default_rng(sum(name.encode())).integers(0, 256, size[::-1], np.uint8)
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    block = exif(**said) if said else b""
    (folder / name).write_bytes(encode_image(pixels, block, "jpeg" if name.endswith("jpg") else "png"))
    return name
