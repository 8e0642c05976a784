"""EXIF from file to file: every tag arrives, sizes and focal planes stay true, broken blocks are mended."""

from __future__ import annotations

import logging
import struct
import warnings
from pathlib import Path
from random import Random
from typing import Any, get_args

import numpy as np
import pytest
from exif_samples import EVERY_TAG, GPS, IMAGE, SHOT, SIZE, block, full_photograph, tags_of
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational as R
from spoilt import BYTES

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.photographs.encode import SUFFIXES, Format, encode_image
from colmap_ihe.photographs.exif import blocks
from colmap_ihe.photographs.exif.blocks import put_together, slimmed, take_apart, with_size
from colmap_ihe.photographs.exif.metadata import decode_metadata, read_metadata, sized
from colmap_ihe.photographs.exif.repair import mend
from colmap_ihe.photographs.png import encode_png

FORMATS: tuple[Format, ...] = get_args(Format)
Pixels = NDArray[np.uint8]
GREY = np.zeros((SIZE[1], SIZE[0]), np.uint8)
COLOUR = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)


def blob(shot: dict[int, Any], image: dict[int, Any] | None = None) -> bytes:
    return block(IMAGE if image is None else image, shot, GPS).tobytes().removeprefix(blocks.PREFIX)


def written(folder: Path, exif: bytes, file_format: Format, pixels: Pixels = GREY) -> Path:
    target = folder / f"out{SUFFIXES[file_format]}"
    target.write_bytes(encode_image(pixels, exif, file_format))
    return target


@pytest.mark.parametrize("pixels", [GREY, COLOUR], ids=["grey", "colour"])
@pytest.mark.parametrize("file_format", FORMATS)
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.dng", "a.orf"])
def test_every_tag_of_every_kind_arrives(
    tmp_path: Path, name: str, file_format: Format, pixels: Pixels
) -> None:
    source = full_photograph(tmp_path / name)
    wanted = tags_of(full_photograph(tmp_path / "like.jpg"))
    assert set(wanted) >= EVERY_TAG
    found = sized(read_metadata(source, "raw" if source.suffix in (".dng", ".orf") else "coded"), *SIZE)
    said = (found.make, found.model, found.focal_mm, found.focal_35mm, found.orientation, found.has_gps)
    assert (*said, found.problem) == ("Canon", "Canon EOS 5D", 24, 24, 6, True, "")
    arrived = tags_of(written(tmp_path, found.exif, file_format, pixels))
    assert {tag: arrived.get(tag) for tag in EVERY_TAG} == {tag: wanted[tag] for tag in EVERY_TAG}


@pytest.mark.parametrize("file_format", FORMATS)
def test_colmap_reads_place_and_turn(tmp_path: Path, file_format: Format) -> None:
    found = read_metadata(full_photograph(tmp_path / "a.dng"), "raw")
    target = written(tmp_path, found.exif, file_format)
    read = pycolmap.Bitmap.read(target, False)
    assert read is not None
    assert read.exif_latitude() == pytest.approx(-(48 + 46 / 60 + 26.5 / 3600))
    assert read.exif_longitude() == pytest.approx(-(2 + 17 / 60 + 49.1 / 3600))
    below = 1 if file_format == "tiff" else -1  # of a TIFF, COLMAP 4.2 does not read that it is below the sea
    assert read.exif_altitude() == pytest.approx(below * 85.5)
    assert read.exif_orientation() == 6


def test_text_that_is_not_ascii_arrives(tmp_path: Path) -> None:
    exif = put_together({**IMAGE, 0x013B: "Müller".encode().decode("latin-1")}, SHOT, {})
    assert tags_of(written(tmp_path, exif, "tiff"))["Image", 0x013B] == "Müller"


def test_tags_that_describe_the_file_they_came_in_stay_behind(tmp_path: Path) -> None:
    """Samsung's JPEGs say a width in the first directory: in a TIFF it would count."""
    exif = blob(SHOT, {**IMAGE, 0x0112: 1, 0x0100: 999, 0x0101: 999, 0x0103: 6, 0x0111: 8, 0x013D: 2})
    target = written(tmp_path, exif, "tiff")
    with Image.open(target) as image:
        assert (image.size, image.mode) == (SIZE, "L")
        assert not np.asarray(image).any()
    assert pycolmap.infer_camera_from_image(target).width == SIZE[0]


def test_a_tiff_of_64_bits_keeps_its_exif(tmp_path: Path) -> None:
    Image.new("RGB", SIZE).save(tmp_path / "a.tif", exif=block(IMAGE, SHOT, GPS), big_tiff=True)
    found = read_metadata(tmp_path / "a.tif", "coded")
    assert (found.make, found.focal_mm, found.has_gps, found.problem) == ("Canon", 24, True, "")


# Focal-plane resolution, in pixels per cm: of 96 pixels on 36 mm, and what becomes of it.
PLANE = 96 / 3.6


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ((96, 64), (96, 64), PLANE),
        ((96, 64), (192, 128), 2 * PLANE),  # as after a program that halved it and left EXIF alone
        ((96, 64), (48, 32), PLANE / 2),
        ((5184, 3456), (5202, 3465), PLANE),  # a RAW file has a few columns more than the camera's JPEG
        ((96, 64), (96, 54), PLANE),  # cut to 16:9
        ((96, 64), (64, 96), PLANE),  # turned
        ((96, 64), (128, 192), 2 * PLANE),
        ((96, 64), (50, 50), None),  # cut or scaled: nobody knows
        ((0, 0), (50, 50), PLANE),  # no size to tell that it changed
    ],
)
def test_focal_plane_resolution_follows_the_size(
    old: tuple[int, int], new: tuple[int, int], expected: float | None
) -> None:
    sides = {0xA002: old[0], 0xA003: old[1]}
    shot = {0x920A: R(24), 0xA210: 3, 0xA20E: R(2400, 90), 0xA20F: R(2400, 90)} | sides
    found = take_apart(bytearray(with_size(blob(shot), *new))).shot
    assert (found[0xA002], found[0xA003]) == new
    if expected is None:
        assert not {0xA20E, 0xA20F, 0xA210} & set(found)
    else:
        assert float(found[0xA20E]) == pytest.approx(expected, rel=1e-6)
        assert float(found[0xA20F]) == pytest.approx(expected, rel=1e-6)
        assert blocks.pixels_per_mm(found) == pytest.approx(expected / 10, rel=1e-6)


def test_colmap_finds_the_true_focal_length_of_a_resized_photograph(tmp_path: Path) -> None:
    """24 mm on 36 mm: two thirds of the longer side, whatever its pixels; COLMAP alone believes the stale tag."""
    stale = SHOT | {0xA002: 960, 0xA003: 640, 0xA20E: R(960 * 10, 36), 0xA20F: R(960 * 10, 36)}
    del stale[0xA405]
    source = tmp_path / "a.jpg"
    Image.new("RGB", SIZE).save(source, exif=block(IMAGE, stale, GPS))
    assert pycolmap.infer_camera_from_image(source).params[0] == pytest.approx(640)
    stale_exif = read_metadata(source, "coded").exif
    for file_format in FORMATS:
        target = written(tmp_path, stale_exif, file_format)
        assert pycolmap.infer_camera_from_image(target).params[0] == pytest.approx(64, rel=1e-5)


def test_exif_that_fits_goes_over_to_the_letter(tmp_path: Path) -> None:
    exif = blob(SHOT | {0x927C: b"offsets into the block"})
    (tmp_path / "a.png").write_bytes(encode_png(COLOUR, exif))
    found = sized(read_metadata(tmp_path / "a.png", "coded"), *SIZE)
    assert found.exif == exif
    assert exif in encode_image(GREY, found.exif, "png")
    assert exif in encode_image(GREY, found.exif, "jpeg")
    resized = take_apart(bytearray(with_size(exif, 70, 50))).shot
    assert 0x927C not in resized
    assert resized[0xA434] == "EF 24-70"
    assert slimmed(exif, len(exif) + 1) == exif
    assert 0x927C not in take_apart(bytearray(slimmed(exif, len(exif)))).shot


@pytest.mark.filterwarnings("ignore:Metadata Warning, tag 0 ")  # of a spoilt tag, by Pillow for Python 3.10
@pytest.mark.parametrize("seed", range(3))
def test_hundreds_of_broken_blocks_lose_tags_and_never_the_photograph(tmp_path: Path, seed: int) -> None:
    """Every warning is an error here, so Pillow finds nothing odd in what is written; and COLMAP reads it."""
    rng = Random(seed)
    whole = blob(SHOT | {0x927C: bytes(200)})
    kept = 0
    for number in range(120):
        (tmp_path / "a.png").write_bytes(encode_png(COLOUR, rng.choice(BYTES)(whole, rng)))
        found = sized(decode_metadata(tmp_path / "a.png", "coded"), *SIZE)
        kept += bool(found.exif)
        assert found.exif or found.problem
        target = written(tmp_path, found.exif, FORMATS[number % 3])
        with Image.open(target) as image:
            image.load()
            exif = image.getexif()
            shot = exif.get_ifd(0x8769)
            assert not found.exif or (shot[0xA002], shot[0xA003]) == SIZE
        camera = pycolmap.infer_camera_from_image(target)
        assert (camera.width, camera.height) == SIZE
    assert kept > 90


@pytest.mark.filterwarnings("ignore::UserWarning")  # Pillow's, of EXIF as it opens the file
@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("name", ["a.jpg", "a.tif", "a.dng"])
def test_broken_files_of_every_kind_are_read_for_what_is_left(tmp_path: Path, name: str) -> None:
    rng = Random(4)
    whole = full_photograph(tmp_path / name).read_bytes()
    kind = "raw" if name == "a.dng" else "coded"
    place = whole.index(b"Exif\0\0") + 6 if name == "a.jpg" else 0
    makes = 0
    logging.getLogger("PIL").setLevel(logging.CRITICAL)
    for _ in range(150):
        header = rng.choice(BYTES)(whole[place : place + 1500], rng).ljust(1500, b"\xff")
        (tmp_path / name).write_bytes(whole[:place] + header[:1500] + whole[place + 1500 :])
        found = decode_metadata(tmp_path / name, kind)
        makes += found.make == "Canon"
        take_apart(bytearray(found.exif or blob({})))
    assert 60 < makes < 150


def test_one_broken_tag_costs_one_tag(tmp_path: Path) -> None:
    """The place of one text is beyond the end; all before and behind it arrive, the maker note where it was."""
    note = b"NOTE" * 20
    exif = bytearray(blob(SHOT | {0x927C: note}))
    assert exif[:2] == b"MM"
    at = exif.index(struct.pack(">HHL", 0xA434, 2, len("EF 24-70") + 1))
    struct.pack_into(">L", exif, at + 8, 2**31)
    (tmp_path / "a.png").write_bytes(encode_png(COLOUR, bytes(exif)))
    found = read_metadata(tmp_path / "a.png", "coded")
    assert "1 tags" in found.problem
    left = take_apart(bytearray(found.exif))
    assert left.lost == 0
    assert set(left.shot) == (set(SHOT) | {0x927C}) - {0xA434}
    assert (set(left.image) - {0x8769, 0x8825}, set(left.gps)) == (set(IMAGE), set(GPS))
    assert found.exif.index(note) == exif.index(note)


def test_a_broken_thumbnail_goes_and_nothing_else() -> None:
    exif = bytearray(blob(SHOT))
    end = 8 + 2 + 12 * struct.unpack_from(">H", exif, 8)[0]
    struct.pack_into(">L", exif, end, len(exif) + 100)
    whole = bytes(exif)
    assert mend(exif) == 0
    assert exif[end : end + 4] == bytes(4)
    assert exif[:end] + exif[end + 4 :] == whole[:end] + whole[end + 4 :]


@pytest.mark.parametrize("junk", [b"", b"I", b"II*\0", b"II*\0\xff\xff\xff\xff", b"no structure at all"])
def test_what_is_no_structure_is_refused(junk: bytes) -> None:
    with pytest.raises(ValueError, match="TIFF structure"):
        mend(bytearray(junk))


def test_what_cannot_be_written_is_left_out() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        exif = put_together({0x010F: "Canon", 0x0112: "upright"}, {0x8827: object(), 0x920A: R(24)}, {})
    found = take_apart(bytearray(exif))
    assert set(found.image) == {0x010F, 0x8769}
    assert set(found.shot) == {0x920A}
    assert put_together({}, {}, {}) == b""
