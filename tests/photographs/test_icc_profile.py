"""Colour profiles: numbers stay as stored, CMYK becomes sRGB, and a profile goes where its colours go."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import tifffile
from icc import grey_profile, red_cyan_profile, rgb_profile
from PIL import Image, ImageCms

from colmap_ihe.errors import PhotographError
from colmap_ihe.photographs.decode import DecodedPhotograph, read_photograph
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.encode import SUFFIXES, Format, encode_image
from colmap_ihe.photographs.exif.metadata import read_metadata
from colmap_ihe.photographs.icc_profile import to_srgb

ADOBE = rgb_profile("Adobe RGB (1998)")
PINK = np.full((70, 80, 3), (200, 100, 120), np.uint8)


def read(file: Path) -> DecodedPhotograph:
    (capture,) = [c for c in discover(file.parent).captures if c.path == file]
    return read_photograph(capture)


def cyan(mode_depth: int = 8) -> Any:
    inks = np.zeros((70, 80, 4), np.uint8)
    inks[..., 0] = 255
    return Image.fromarray(inks, "CMYK") if mode_depth == 8 else inks.astype(np.uint16) * 257


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "deep.tif"])
def test_rgb_numbers_are_taken_as_stored_and_keep_their_profile(tmp_path: Path, name: str) -> None:
    if name == "deep.tif":
        deep = PINK.astype(np.uint16) * 257
        tifffile.imwrite(tmp_path / name, deep, photometric="rgb", iccprofile=ADOBE)
    else:
        Image.fromarray(PINK).save(tmp_path / name, icc_profile=ADOBE)
    found = read(tmp_path / name)
    assert np.abs(found.rgb.astype(int) - PINK).max() <= 1  # JPEG; the profile would change green by 1 to 30
    assert found.profile == ADOBE
    assert read_metadata(tmp_path / name, "coded").profile == "Adobe RGB"


@pytest.mark.parametrize(
    ("profile", "name"),
    [
        (None, "sRGB"),
        (ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(), "sRGB"),
        (rgb_profile("sRGB IEC61966-2.1"), "sRGB"),
        (ADOBE, "Adobe RGB"),
        (rgb_profile("ProPhoto"), "ProPhoto"),
        (rgb_profile(""), "a profile without a name"),
        (grey_profile(), "sRGB"),  # a grey image says nothing of RGB
        (ADOBE[:140], "a profile that cannot be read"),
        (ADOBE.replace(b"rXYZ", b"none"), "a profile that cannot be read"),  # it has a name, and no red
    ],
)
def test_profiles_have_names(tmp_path: Path, profile: bytes | None, name: str) -> None:
    Image.fromarray(PINK).save(tmp_path / "a.png", icc_profile=profile)
    assert read_metadata(tmp_path / "a.png", "coded").profile == name


def test_a_camera_says_adobe_rgb_by_exif_alone(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = 0xFFFF
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    Image.fromarray(PINK).save(tmp_path / "a.jpg", exif=exif)
    assert read_metadata(tmp_path / "a.jpg", "coded").profile == "Adobe RGB"


@pytest.mark.parametrize(
    ("profile", "name"), [(ADOBE, "Adobe RGB"), (b"", "Adobe RGB"), (rgb_profile("X"), "X"), (b"", "sRGB")]
)
def test_colours_come_to_srgb(profile: bytes, name: str) -> None:
    """Adobe RGB of 200, 100, 120 is 227, 100, 122 in sRGB; what its green has beyond sRGB is cut."""
    pixels = np.array([[[200, 100, 120], [90, 90, 90], [0, 255, 0]]], np.uint8)
    expected = [[227, 100, 122], [90, 90, 90], [0, 255, 0]] if name != "sRGB" else pixels[0]
    assert np.abs(to_srgb(pixels, profile, name)[0].astype(int) - expected).max() <= 1


def test_a_profile_that_cannot_be_used_leaves_the_numbers_alone() -> None:
    np.testing.assert_array_equal(to_srgb(PINK, ADOBE[:140], "a profile that cannot be read"), PINK)


@pytest.mark.parametrize("name", ["a.jpg", "a.tif", "deep.tif"])
@pytest.mark.parametrize(
    ("profile", "expected", "most"), [(red_cyan_profile(), (255, 0, 0), 25), (None, (0, 255, 255), 2)]
)
def test_cmyk_goes_through_its_profile_if_it_has_one(
    tmp_path: Path, name: str, profile: bytes | None, expected: tuple[int, int, int], most: int
) -> None:
    """Its cyan is red; without the profile it is cyan."""
    if name == "deep.tif":
        tifffile.imwrite(tmp_path / name, cyan(16), photometric="separated", iccprofile=profile)
    else:
        cyan().save(tmp_path / name, icc_profile=profile)
    found = read(tmp_path / name)
    assert found.profile == b""
    assert np.abs(found.rgb.astype(int) - expected).max() <= most


@pytest.mark.parametrize("profile", [b"no profile", ADOBE])
def test_cmyk_with_a_profile_that_cannot_be_used_is_refused(tmp_path: Path, profile: bytes) -> None:
    cyan().save(tmp_path / "a.jpg", icc_profile=profile)
    with pytest.raises(PhotographError, match=r"a\.jpg: a CMYK photograph whose ICC profile cannot be used"):
        read(tmp_path / "a.jpg")


@pytest.mark.parametrize("file_format", get_args(Format))
def test_a_colour_twin_carries_the_profile_and_a_grey_image_none(tmp_path: Path, file_format: Format) -> None:
    for name, pixels, profile in (("colour", PINK, ADOBE), ("grey", PINK[..., 0], b"")):
        file = tmp_path / f"{name}{SUFFIXES[file_format]}"
        file.write_bytes(encode_image(np.ascontiguousarray(pixels), b"", file_format, profile))
        with Image.open(file) as image:
            image.load()
            assert image.info.get("icc_profile", b"") == profile
            assert np.abs(np.asarray(image).astype(int) - pixels).max() <= 1
