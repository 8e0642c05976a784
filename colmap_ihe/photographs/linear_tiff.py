"""A linear photograph as a TIFF of 16 bit a channel, with its EXIF. TIFF 6.0; Pillow writes no such pixels itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import TiffTags
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from colmap_ihe.photographs.exif.blocks import Tag, for_tiff, with_size

_HEADER = b"II*\0\x08\0\0\0"  # little-endian, the first directory follows at once


def encode_linear_tiff(linear_rgb: NDArray[np.uint16], exif: bytes) -> bytes:
    """Return the bytes of the file: linear_rgb (H, W, 3) uint16, not compressed, in one strip; `exif` a TIFF structure
    or empty. Pixel dimensions in EXIF become those of the image. Raises ValueError for another shape or dtype."""
    if linear_rgb.ndim != 3 or linear_rgb.shape[2] != 3 or linear_rgb.dtype != np.uint16:
        raise ValueError(f"{linear_rgb.shape=} {linear_rgb.dtype=}, expected (H, W, 3) uint16")
    height, width = linear_rgb.shape[:2]
    tags = for_tiff(with_size(exif, width, height))
    directory = ImageFileDirectory_v2()
    for tag, value in tags.items():
        if tag not in (Tag.EXIF_IFD, Tag.GPS_IFD):
            directory[tag] = value
    for tag in (Tag.EXIF_IFD, Tag.GPS_IFD):
        if inner := dict(tags.get_ifd(tag)):
            directory[tag] = inner
    layout = [
        *((256, TiffTags.LONG, width), (257, TiffTags.LONG, height)),
        *((258, TiffTags.SHORT, (16, 16, 16)), (259, TiffTags.SHORT, 1)),  # bits, compression: none
        *((262, TiffTags.SHORT, 2), (273, TiffTags.LONG, 0)),  # RGB; the strip's offset is set by Pillow
        *((277, TiffTags.SHORT, 3), (278, TiffTags.LONG, height)),  # samples per pixel, rows per strip
        *((279, TiffTags.LONG, linear_rgb.nbytes), (284, TiffTags.SHORT, 1)),  # bytes; channels side by side
    ]
    for tag, kind, value in layout:
        directory.tagtype[tag] = kind
        directory[tag] = value
    # Pillow moves strip offset 0 to the first byte after the directory: that is where the pixels go.
    return _HEADER + directory.tobytes(len(_HEADER)) + linear_rgb.astype("<u2", copy=False).tobytes()
