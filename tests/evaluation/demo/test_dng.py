"""The DNG writer against readers that know nothing of it: rawpy (LibRaw), exifread, Pillow."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import exifread
import numpy as np
import numpy.typing as npt
import pytest
import rawpy

from colmap_ihe.evaluation.demo.dng import PATTERNS, write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif

Pixels = npt.NDArray[np.uint16]
NEUTRAL = (0.5, 1.0, 0.625)
MATRIX = np.array(((0.9, -0.3, -0.1), (-0.4, 1.3, 0.1), (0.0, 0.2, 0.6)))


def tags_of(file: Path) -> dict[str, Any]:
    with file.open("rb") as stream:
        return dict(exifread.process_file(stream, details=False))


def write(path: Path, mosaic: Pixels, **changes: Any) -> None:
    options: dict[str, Any] = {"black": 512, "white": 16383, "exif": PhotoExif()} | changes
    write_dng(path, mosaic, as_shot_neutral=NEUTRAL, colour_matrix=MATRIX, **options)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_raw_values_come_back_unchanged(tmp_path: Path, pattern: str) -> None:
    mosaic = np.random.default_rng(1).integers(0, 16384, (90, 134), np.uint16)
    write(tmp_path / "a.dng", mosaic, pattern=pattern)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, mosaic)
        assert raw.black_level_per_channel == [512] * 4
        assert raw.white_level == 16383
        assert (raw.sizes.width, raw.sizes.height) == (134, 90)
        assert (raw.sizes.raw_width, raw.sizes.raw_height) == (134, 90)
        assert raw.raw_pattern is not None
        colours = "".join(chr(raw.color_desc[k]) for k in raw.raw_pattern.ravel())
        assert colours == pattern
        red, green, blue = raw.camera_whitebalance[:3]
        assert (red / green, blue / green) == pytest.approx((1 / NEUTRAL[0], 1 / NEUTRAL[2]), rel=1e-3)


@pytest.mark.parametrize("orientation", [1, 6])
def test_exif_is_read_by_others(tmp_path: Path, orientation: int) -> None:
    exif = PhotoExif(make="Maker", model="Model 5", exposure_time_s=Fraction(1, 160), f_number=5.6, iso=200)
    write(tmp_path / "a.dng", np.full((64, 96), 700, np.uint16), exif=exif, orientation=orientation)
    tags = {name: str(value) for name, value in tags_of(tmp_path / "a.dng").items()}
    expected = {
        "Image Make": "Maker", "Image Model": "Model 5", "EXIF ExposureTime": "1/160", "EXIF FNumber": "28/5",
        "EXIF ISOSpeedRatings": "200", "EXIF LensModel": "Demo lens 30 mm", "EXIF FocalLengthIn35mmFilm": "30",
        "EXIF DateTimeOriginal": "2016:06:21 10:00:00", "EXIF ExifImageWidth": "96", "EXIF ExifImageLength": "64",
    }  # fmt: skip
    assert {name: tags.get(name) for name in expected} == expected
    assert tags_of(tmp_path / "a.dng")["Image Orientation"].values == [orientation]


def test_empty_fields_leave_their_tags_out(tmp_path: Path) -> None:
    exif = PhotoExif(make="", focal_length_mm=None, focal_length_35mm=None)
    write(tmp_path / "a.dng", np.full((64, 64), 700, np.uint16), exif=exif)
    tags = tags_of(tmp_path / "a.dng")
    assert "EXIF ExposureTime" in tags
    assert not {"Image Make", "EXIF FocalLength", "EXIF FocalLengthIn35mmFilm"} & tags.keys()


@pytest.mark.parametrize(
    ("mosaic", "changes", "message"),
    [
        (np.zeros((5, 6), np.uint16), {}, "H and W even"),
        (np.zeros((6, 6), np.uint8), {}, "uint8"),
        (np.zeros((6, 6), np.uint16), {"pattern": "RGB"}, "pattern='RGB'"),
        (np.zeros((6, 6), np.uint16), {"black": 600, "white": 500}, "black=600"),
    ],
)
def test_wrong_values(tmp_path: Path, mosaic: Pixels, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        write(tmp_path / "a.dng", mosaic, **changes)
    assert list(tmp_path.iterdir()) == []
