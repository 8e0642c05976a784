"""Arrays to image files that keep their EXIF."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.photographs.exif.blocks import PREFIX, for_tiff, slimmed, with_size
from colmap_ihe.photographs.png import encode_png

Format = Literal["png", "tiff", "jpeg"]
SUFFIXES: Mapping[Format, str] = {"png": ".png", "tiff": ".tif", "jpeg": ".jpg"}
_JPEG_QUALITY = 95
_JPEG_EXIF_LIMIT = 65_000  # a JPEG segment; a maker note may be larger


def encode_image(pixels: NDArray[np.uint8], exif: bytes, file_format: Format, profile: bytes = b"") -> bytes:
    """Return the bytes of an image file: pixels (H, W) grey or (H, W, 3) RGB uint8; `exif` a TIFF structure or empty;
    `profile` the ICC profile of RGB pixels or empty.

    Pixel dimensions in EXIF become those of the image. TIFF is not compressed, JPEG is of quality 95. A maker
    note is left out of TIFF, where its offsets would be wrong, and of JPEG where there is no room for it.
    """
    exif = with_size(exif, pixels.shape[1], pixels.shape[0])
    if file_format == "png":
        return encode_png(pixels, exif, profile)
    buffer, image, icc = BytesIO(), Image.fromarray(pixels), profile or None
    if file_format == "tiff":
        image.save(buffer, "TIFF", exif=for_tiff(exif), icc_profile=icc)
    else:
        slim = slimmed(exif, _JPEG_EXIF_LIMIT)
        slim = PREFIX + slim if slim else b""
        image.save(buffer, "JPEG", quality=_JPEG_QUALITY, exif=slim, icc_profile=icc)
    return buffer.getvalue()
