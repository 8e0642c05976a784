"""A linear photograph as a TIFF of 16 bit a channel, with its EXIF. TIFF 6.0; Pillow writes no such pixels itself.

What its colours are is said by tags of the Digital Negative Specification 1.4: ColorMatrix1 (CIE XYZ to the sensor's
colours), AsShotNeutral (white) and LinearResponseLimit. A TIFF of 16 bit with the first two and no ICC profile is
linear, whoever wrote it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import TiffTags
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from colmap_ihe.photographs.exif.blocks import Tag, for_tiff, with_size

_HEADER = b"II*\0\x08\0\0\0"  # little-endian, the first directory follows at once
_COLOR_MATRIX, _AS_SHOT_NEUTRAL, _LINEAR_LIMIT, _ILLUMINANT = 50721, 50728, 50734, 50778
_D65 = 21  # EXIF's number of the light that the matrix is for
_XYZ_FROM_SRGB = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)  # IEC 61966-2-1, white D65


@dataclass(frozen=True)
class SensorColours:
    """Say what linear colours are: `white_balance`, factors of red, green and blue, 1 for green; then
    `srgb_from_balanced`, 3x3, whose rows sum to 1."""

    white_balance: tuple[float, float, float]
    srgb_from_balanced: NDArray[np.float64]

    def srgb_from_camera(self, white_balance: tuple[float, ...] = ()) -> NDArray[np.float64]:
        """Return balance and matrix in one, (3, 3); with another balance if it is given."""
        return np.asarray(self.srgb_from_balanced @ np.diag(white_balance or self.white_balance))


def encode_linear_tiff(
    linear_rgb: NDArray[np.uint16], exif: bytes, srgb_from_camera: NDArray[np.float64] | None = None
) -> bytes:
    """Return the bytes of the file: linear_rgb (H, W, 3) uint16, not compressed, in one strip; `exif` a TIFF structure
    or empty; `srgb_from_camera` (3, 3), white balance and matrix in one. Pixel dimensions in EXIF become those of the
    image. Raises ValueError for another shape or dtype."""
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
        *_colour_tags(np.eye(3) if srgb_from_camera is None else srgb_from_camera),
    ]
    for tag, kind, value in layout:
        directory.tagtype[tag] = kind
        directory[tag] = value
    # Pillow moves strip offset 0 to the first byte after the directory: that is where the pixels go.
    return _HEADER + directory.tobytes(len(_HEADER)) + linear_rgb.astype("<u2", copy=False).tobytes()


def _colour_tags(srgb_from_camera: NDArray[np.float64]) -> list[tuple[int, int, Any]]:
    camera_from_srgb = np.linalg.inv(srgb_from_camera)
    neutral = camera_from_srgb.sum(axis=1)  # what becomes white
    matrix = camera_from_srgb @ np.linalg.inv(_XYZ_FROM_SRGB)
    return [
        (_COLOR_MATRIX, TiffTags.SIGNED_RATIONAL, tuple(matrix.ravel().tolist())),
        (_AS_SHOT_NEUTRAL, TiffTags.RATIONAL, tuple((neutral / neutral.max()).tolist())),
        (_LINEAR_LIMIT, TiffTags.RATIONAL, 1.0),
        (_ILLUMINANT, TiffTags.SHORT, _D65),
    ]


def sensor_colours(tags: Any) -> SensorColours | None:
    """Return what the tags of a TIFF's first directory say of linear colours; None where they say nothing that can be
    used."""
    try:
        matrix = np.array([float(v) for v in tags[_COLOR_MATRIX]]).reshape(3, 3)
        neutral = np.array([float(v) for v in tags[_AS_SHOT_NEUTRAL]])
        camera_from_srgb = matrix @ _XYZ_FROM_SRGB
        balanced_from_srgb = camera_from_srgb / camera_from_srgb.sum(axis=1, keepdims=True)
        srgb_from_balanced = np.linalg.inv(balanced_from_srgb)
        red, green, blue = (float(v) for v in neutral)
    except (KeyError, TypeError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return None
    if (
        not np.isfinite(srgb_from_balanced).all()
        or not 0 < min(red, green, blue) <= max(red, green, blue) < 1e6
    ):
        return None
    return SensorColours((green / red, 1.0, green / blue), srgb_from_balanced)
