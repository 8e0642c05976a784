"""Write a Bayer mosaic as a DNG, the RAW format that every RAW reader knows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import ExifTags, TiffTags
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from colmap_ihe.evaluation.demo.exif import PhotoExif, exif_tags, main_tags
from colmap_ihe.machine.files import write_bytes

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")

_CFA = 32803  # the photometric interpretation of a mosaic
_D65 = 21  # EXIF's number of the light that the colour matrix is for
_HEADER = b"II*\0\x08\0\0\0"  # little-endian TIFF whose first directory follows at once


def write_dng(
    path: Path,
    mosaic_u16: npt.NDArray[np.uint16],
    *,
    black: int,
    white: int,
    as_shot_neutral: tuple[float, float, float],
    colour_matrix: npt.NDArray[np.float64],
    pattern: str = "RGGB",
    exif: PhotoExif,
    orientation: int = 1,
) -> None:
    """Write `path` whole or not at all; uncompressed, nothing cropped, no thumbnail.

    `mosaic_u16` is (H, W) uint16 with even H and W, the raw values of the sensor: `black` is no
    light, `white` saturation. `pattern` names the colours of the top-left 2x2 cell row by row.
    `as_shot_neutral` is the linear (R, G, B) of a neutral object, each in (0, 1];
    `colour_matrix` is (3, 3), CIE XYZ (D65) to linear camera RGB. `orientation` is EXIF's, 1..8;
    the pixels are stored as given. Raises ValueError for anything else.
    Tags: Digital Negative Specification 1.4.
    """
    if mosaic_u16.ndim != 2 or mosaic_u16.dtype != np.uint16 or any(n % 2 for n in mosaic_u16.shape):
        raise ValueError(f"{mosaic_u16.shape=}, {mosaic_u16.dtype=}, expected (H, W) uint16, H and W even")
    if not 0 <= black < white <= 65535:
        raise ValueError(f"{black=}, {white=}, expected 0 <= black < white <= 65535")
    if pattern not in PATTERNS:
        raise ValueError(f"{pattern=}, expected one of {', '.join(PATTERNS)}")
    height, width = mosaic_u16.shape
    directory = ImageFileDirectory_v2()
    directory.update(main_tags(exif, orientation))
    directory[ExifTags.IFD.Exif] = exif_tags(exif, width, height)
    mosaic_tags = _mosaic_tags(width, height, black, white, pattern)
    for tag, kind, value in (*mosaic_tags, *_colour_tags(exif, as_shot_neutral, colour_matrix)):
        directory.tagtype[tag] = kind
        directory[tag] = value
    pixels = mosaic_u16.astype("<u2", copy=False).tobytes()
    # Pillow moves strip offset 0 to the first byte after the directory: that is where the pixels go.
    write_bytes(path, _HEADER + directory.tobytes(len(_HEADER)) + pixels)


def _mosaic_tags(width: int, height: int, black: int, white: int, pattern: str) -> list[tuple[int, int, Any]]:
    """Return (tag, TIFF type, value) of what says how the pixels lie in the file."""
    cell = bytes("RGB".index(colour) for colour in pattern)
    return [
        (254, TiffTags.LONG, 0),  # NewSubfileType: the full picture
        (256, TiffTags.LONG, width),
        (257, TiffTags.LONG, height),
        (258, TiffTags.SHORT, 16),  # BitsPerSample
        (259, TiffTags.SHORT, 1),  # Compression: none
        (262, TiffTags.SHORT, _CFA),
        (273, TiffTags.LONG, 0),  # StripOffsets: set by Pillow
        (277, TiffTags.SHORT, 1),  # SamplesPerPixel
        (278, TiffTags.LONG, height),  # RowsPerStrip
        (279, TiffTags.LONG, 2 * width * height),  # StripByteCounts
        (284, TiffTags.SHORT, 1),  # PlanarConfiguration
        (33421, TiffTags.SHORT, (2, 2)),  # CFARepeatPatternDim
        (33422, TiffTags.BYTE, cell),  # CFAPattern
        (50714, TiffTags.LONG, black),
        (50717, TiffTags.LONG, white),
    ]


def _colour_tags(
    exif: PhotoExif, as_shot_neutral: tuple[float, float, float], colour_matrix: npt.NDArray[np.float64]
) -> list[tuple[int, int, Any]]:
    """Return (tag, TIFF type, value) of what makes the TIFF a DNG and says what its colours mean."""
    if colour_matrix.shape != (3, 3):
        raise ValueError(f"{colour_matrix.shape=}, expected (3, 3)")
    return [
        (50706, TiffTags.BYTE, bytes((1, 4, 0, 0))),  # DNGVersion
        (50707, TiffTags.BYTE, bytes((1, 1, 0, 0))),  # DNGBackwardVersion
        (50708, TiffTags.ASCII, f"{exif.make} {exif.model}".strip() or "Unknown"),  # UniqueCameraModel
        (50721, TiffTags.SIGNED_RATIONAL, tuple(float(x) for x in colour_matrix.ravel())),
        (50728, TiffTags.RATIONAL, tuple(float(x) for x in as_shot_neutral)),
        (50778, TiffTags.SHORT, _D65),  # CalibrationIlluminant1
    ]
