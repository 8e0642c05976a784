"""What files hold that would be taken for something else is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image, PngImagePlugin

from colmap_ihe.errors import OptionError
from colmap_ihe.evaluation.demo.exif import PhotoExif, jpeg_exif
from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.survey import Surveyed, survey
from colmap_ihe.pipeline.stages.dense import STAGE
from colmap_ihe.pipeline.warnings.files import depth_warnings, panorama_warnings
from colmap_ihe.project.options import Options

GPANO = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description GPano:ProjectionType="{}"/></x:xmpmeta>'
PIXELS = np.random.default_rng(1).integers(0, 4096, (100, 200, 3)).astype(np.uint16)


def picture(file: Path, projection: str = "", apples: bool = False) -> None:
    exif = jpeg_exif(PhotoExif(make="Apple" if apples else "Maker", model="M"), 200, 100, 1)
    if apples:
        exif.get_ifd(0x8769)[0xA401] = 6
    text = GPANO.format(projection)
    more: dict[str, Any] = {"exif": exif} | ({"xmp": text.encode()} if projection else {})
    if projection and file.suffix == ".png":
        more["pnginfo"] = PngImagePlugin.PngInfo()
        more["pnginfo"].add_itxt("XML:com.adobe.xmp", text)
    Image.fromarray((PIXELS >> 4).astype(np.uint8)).save(file, **more)


def surveyed(folder: Path) -> list[Surveyed]:
    with local_executor() as executor:
        return survey(discover(folder).captures, executor, SILENT, strict=True)[0]


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_panoramas_are_told_one_by_one(tmp_path: Path, suffix: str) -> None:
    picture(tmp_path / f"flat.{suffix}")
    picture(tmp_path / f"round.{suffix}", "equirectangular")
    if suffix == "tif":  # Pillow writes no XMP there
        data = GPANO.format("equirectangular").encode()
        tifffile.imwrite(
            tmp_path / "round.tif", PIXELS, photometric="rgb", extratags=[(700, 1, len(data), data, True)]
        )
    (warning,) = panorama_warnings(surveyed(tmp_path))
    assert warning.startswith(f"1 equirectangular panorama in the set, round.{suffix}: COLMAP takes each")
    assert "flat views, or take it out" in warning


def test_a_set_of_panoramas_alone_may_be_a_sparse_model(tmp_path: Path) -> None:
    for number in range(7):
        picture(tmp_path / f"{number}.jpg", "equirectangular")
    (warning,) = panorama_warnings(surveyed(tmp_path))
    assert warning.startswith(
        "7 equirectangular panoramas in the set, 0.jpg, 1.jpg, 2.jpg, 3.jpg, 4.jpg and 2 more:"
    )
    assert "--set camera.model=EQUIRECTANGULAR --no-dense" in warning
    spherical = Options.model_validate({"camera": {"model": "EQUIRECTANGULAR"}})
    with pytest.raises(OptionError, match="of which dense stereo can make no flat images"):
        STAGE.check(spherical, 7)


def test_the_panorama_of_a_phone(tmp_path: Path) -> None:
    picture(tmp_path / "a.jpg", apples=True)
    picture(tmp_path / "b.jpg", "rectilinear")
    (warning,) = panorama_warnings(surveyed(tmp_path))
    assert warning.startswith("1 cylindrical panorama in the set, a.jpg:")
    assert warning.endswith("Take single photographs instead")


@pytest.mark.parametrize(
    ("bits", "told"), [(10, "level 4 of 255"), (12, "level 16 of 255"), (14, "level 64 of 255"), (16, "")]
)
def test_few_bits_in_files_of_16_are_told(tmp_path: Path, bits: int, told: str) -> None:
    values = np.linspace(0, 2**bits - 1, 100 * 200 * 3).astype(np.uint16).reshape(100, 200, 3)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb")
    counts = SetCounts(Histogram())
    captures = discover(tmp_path).captures
    counts.histogram.add(read_photograph(captures[0]).rgb)
    warnings = depth_warnings(captures, {"coded": counts})
    assert [told in w and f"{bits} bits lie in files of 16" in w for w in warnings] == (
        [True] if told else []
    )


@pytest.mark.parametrize(("name", "level"), [("a.jpg", 10), ("a.tif", 0), ("a.tif", 65)])
def test_dark_photographs_of_8_bits_and_black_ones_are_not(tmp_path: Path, name: str, level: int) -> None:
    Image.new("RGB", (100, 100), (level, level, level)).save(tmp_path / name)
    counts = SetCounts(Histogram())
    captures = discover(tmp_path).captures
    counts.histogram.add(np.full((100, 100, 3), level, np.uint8))
    assert depth_warnings(captures, {"coded": counts}) == []
