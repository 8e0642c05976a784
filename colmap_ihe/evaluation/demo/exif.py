"""Describe the demo's photographs in EXIF, in the same words for RAW and JPEG."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

_BASE = ExifTags.Base


@dataclass(frozen=True, kw_only=True)
class PhotoExif:
    """Describe one shot as a camera does. A field that is None or empty leaves its tag out."""

    make: str = "colmap-ihe"
    model: str = "Demo camera"
    lens_model: str = "Demo lens 30 mm"
    taken: str = "2016:06:21 10:00:00"  # EXIF's own form, "YYYY:MM:DD HH:MM:SS"
    exposure_time_s: Fraction | None = Fraction(1, 125)
    f_number: float | None = 8.0
    iso: int | None = 100
    focal_length_mm: float | None = 30.0
    focal_length_35mm: int | None = 30


def main_tags(exif: PhotoExif, orientation: int) -> dict[int, Any]:
    """Return the tags of the first image directory, by number: maker, model, time, orientation (1..8)."""
    tags = {
        _BASE.Make: exif.make,
        _BASE.Model: exif.model,
        _BASE.Orientation: orientation,
        _BASE.Software: "colmap-ihe demo",
        _BASE.DateTime: exif.taken,
    }
    return _present(tags)


def exif_tags(exif: PhotoExif, width: int, height: int) -> dict[int, Any]:
    """Return the tags of the EXIF sub-directory, by number; `width` and `height` in pixels as stored."""
    tags = {
        _BASE.ExposureTime: _rational(exif.exposure_time_s),
        _BASE.FNumber: _rational(exif.f_number),
        _BASE.ISOSpeedRatings: exif.iso,
        _BASE.ExifVersion: b"0232",
        _BASE.DateTimeOriginal: exif.taken,
        _BASE.FocalLength: _rational(exif.focal_length_mm),
        _BASE.ExifImageWidth: width,
        _BASE.ExifImageHeight: height,
        _BASE.FocalLengthIn35mmFilm: exif.focal_length_35mm,
        _BASE.LensModel: exif.lens_model,
    }
    return _present(tags)


def jpeg_exif(exif: PhotoExif, width: int, height: int, orientation: int = 1) -> Image.Exif:
    """Return the block that `Image.save(..., exif=...)` takes."""
    block = Image.Exif()
    block.update(main_tags(exif, orientation))
    block.get_ifd(ExifTags.IFD.Exif).update(exif_tags(exif, width, height))
    return block


def _present(tags: Mapping[Any, Any]) -> dict[int, Any]:
    return {int(tag): value for tag, value in tags.items() if value not in (None, "")}


def _rational(value: Fraction | float | None) -> IFDRational | None:
    if value is None:
        return None
    exact = Fraction(value).limit_denominator(10_000)
    return IFDRational(exact.numerator, exact.denominator)
