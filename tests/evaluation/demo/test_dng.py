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
from PIL import ExifTags, Image

from colmap_ihe.evaluation.demo.dng import PATTERNS, write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif

Pixels = npt.NDArray[np.uint16]
NEUTRAL = (0.5, 1.0, 0.625)
MATRIX = np.array(((0.9, -0.3, -0.1), (-0.4, 1.3, 0.1), (0.0, 0.2, 0.6)))
MINIMAL: dict[str, Any] = {
    "gamma": (1, 1),
    "no_auto_bright": True,
    "output_bps": 16,
    "use_camera_wb": False,
    "user_wb": [1, 1, 1, 1],
    "output_color": rawpy.ColorSpace.raw,
    "user_flip": 0,
    "no_auto_scale": True,
}


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


@pytest.mark.parametrize("pattern", PATTERNS)
def test_minimal_development_gives_the_colours_that_were_written(tmp_path: Path, pattern: str) -> None:
    values = {"R": 3000, "G": 9000, "B": 6000}
    mosaic = np.tile(np.array([values[c] for c in pattern], np.uint16).reshape(2, 2), (40, 60))
    write(tmp_path / "a.dng", mosaic, pattern=pattern)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        rgb = raw.postprocess(**MINIMAL)
    assert rgb.shape == (80, 120, 3)
    np.testing.assert_array_equal(np.unique(rgb.reshape(-1, 3), axis=0), [[2488, 8488, 5488]])


@pytest.mark.parametrize("orientation", [1, 6])
def test_exif_is_read_by_others(tmp_path: Path, orientation: int) -> None:
    exif = PhotoExif(make="Maker", model="Model 5", exposure_time_s=Fraction(1, 160), f_number=5.6, iso=200)
    write(tmp_path / "a.dng", np.full((64, 96), 700, np.uint16), exif=exif, orientation=orientation)
    with (tmp_path / "a.dng").open("rb") as file:
        tags = exifread.process_file(file, details=False)
    assert (str(tags["Image Make"]), str(tags["Image Model"])) == ("Maker", "Model 5")
    assert tags["Image Orientation"].values == [orientation]
    assert str(tags["EXIF ExposureTime"]) == "1/160"
    assert str(tags["EXIF DateTimeOriginal"]) == "2016:06:21 10:00:00"
    assert str(tags["EXIF FocalLengthIn35mmFilm"]) == "30"

    block = Image.Exif()
    with (tmp_path / "a.dng").open("rb") as file:
        block.load_from_fp(file)
        inner = block.get_ifd(ExifTags.IFD.Exif)
        assert float(inner[ExifTags.Base.FNumber]) == pytest.approx(5.6)
        assert inner[ExifTags.Base.ISOSpeedRatings] == 200
        assert inner[ExifTags.Base.LensModel] == "Demo lens 30 mm"
        assert (inner[ExifTags.Base.ExifImageWidth], inner[ExifTags.Base.ExifImageHeight]) == (96, 64)

    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        assert raw.postprocess(**MINIMAL).shape == (64, 96, 3)


def test_empty_fields_leave_their_tags_out(tmp_path: Path) -> None:
    exif = PhotoExif(make="", focal_length_mm=None, focal_length_35mm=None)
    write(tmp_path / "a.dng", np.full((64, 64), 700, np.uint16), exif=exif)
    with (tmp_path / "a.dng").open("rb") as file:
        tags = exifread.process_file(file, details=False)
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
