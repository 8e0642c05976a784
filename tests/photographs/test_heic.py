"""HEIC as phones write it: pixels as the sensor had them, and EXIF with its Orientation."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from heic import QUARTERS, SIZE, write_heic

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.photographs.exif.metadata import read_metadata
from colmap_ihe.photographs.preview import small_picture
from colmap_ihe.photographs.survey import survey


def capture(folder: Path) -> Capture:
    (found,) = discover(folder).captures
    return found


def size_of(folder: Path) -> tuple[int, int]:
    """Return width and height by the header."""
    with ThreadPoolExecutor(1) as threads:
        (surveyed,), _ = survey([capture(folder)], threads, SILENT, strict=True)
    return surveyed.width, surveyed.height


def quarters(rgb: np.ndarray) -> dict[str, tuple[int, ...]]:
    height, width = rgb.shape[:2]
    places = {"top left": (12, 12), "top right": (12, width - 12), "bottom left": (height - 12, 12)}
    return {name: tuple(int(v) for v in rgb[place]) for name, place in places.items()}


def test_pixels_lie_as_the_sensor_had_them_and_the_tag_says_how_to_turn_them(tmp_path: Path) -> None:
    write_heic(tmp_path / "IMG_0001.HEIC")
    photograph = read_photograph(capture(tmp_path))
    assert size_of(tmp_path) == SIZE
    assert photograph.rgb.shape == (SIZE[1], SIZE[0], 3)
    assert photograph.encoding == "coded"
    for name, colour in quarters(photograph.rgb).items():
        assert colour == pytest.approx(QUARTERS[name], abs=8), name
    assert quarters(small_picture(capture(tmp_path), 64)).keys() == QUARTERS.keys()


def test_exif_arrives_with_its_orientation(tmp_path: Path) -> None:
    write_heic(tmp_path / "IMG_0001.HEIC")
    metadata = read_metadata(tmp_path / "IMG_0001.HEIC", "coded")
    assert (metadata.make, metadata.model, metadata.orientation) == ("Apple", "iPhone 15", 6)
    assert (metadata.focal_mm, metadata.focal_35mm, metadata.problem) == (6.5, 24, "")
    assert b"\x01\x12\0\x03\0\0\0\x01\0\x06" in metadata.exif


@pytest.mark.parametrize(("turned", "tag"), [(False, 6), (True, 8), (True, 1)])
def test_where_box_and_tag_differ_the_box_counts(tmp_path: Path, turned: bool, tag: int) -> None:
    """The format's own box decides how a photograph is seen; the pixels are upright then, and the tag is 1."""
    write_heic(tmp_path / "a.heic", turned=turned, tag=tag)
    upright = SIZE[::-1] if turned else SIZE
    assert size_of(tmp_path) == upright
    assert read_photograph(capture(tmp_path)).rgb.shape == (upright[1], upright[0], 3)
    assert read_metadata(tmp_path / "a.heic", "coded").orientation == 1


def test_it_is_the_other_half_of_a_raw_file(tmp_path: Path) -> None:
    for name in ("IMG_1.DNG", "IMG_1.HEIC", "b.HIF"):
        (tmp_path / name).touch()
    assert [(c.name, c.paired) for c in discover(tmp_path).captures] == [
        ("IMG_1.DNG", ("IMG_1.HEIC",)),
        ("b.HIF", ()),
    ]


def test_a_broken_one_is_named(tmp_path: Path) -> None:
    write_heic(tmp_path / "a.heic")
    (tmp_path / "a.heic").write_bytes((tmp_path / "a.heic").read_bytes()[:500])
    with pytest.raises(PhotographError, match=r"a\.heic: cannot be read"):
        read_photograph(capture(tmp_path))
