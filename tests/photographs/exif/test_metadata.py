"""What EXIF says arrives in the grey image: pycolmap, which decides by it, must see no difference."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational as R

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.evaluation.demo.exif import PhotoExif, jpeg_exif
from colmap_ihe.photographs.coded import stored_header
from colmap_ihe.photographs.encode import SUFFIXES, Format, encode_image
from colmap_ihe.photographs.exif import metadata as captures_metadata
from colmap_ihe.photographs.exif.metadata import Metadata, decode_metadata, read_metadata, sized
from colmap_ihe.photographs.raw.develop import LibrawMetadata, libraw_metadata

FORMATS: tuple[Format, ...] = get_args(Format)
SIZE = (96, 64)
GPS = {1: "N", 2: (48.0, 46.0, 26.5), 3: "E", 4: (2.0, 17.0, 49.1), 5: b"\x00", 6: 85.5}


def photograph(folder: Path, name: str = "a.jpg", **changes: Any) -> Path:
    """A JPEG, PNG or TIFF with EXIF as a camera writes it; `orientation`, `gps` and `shot` besides `PhotoExif`'s."""
    orientation, gps, shot = changes.pop("orientation", 1), changes.pop("gps", {}), changes.pop("shot", {})
    exif = jpeg_exif(replace(PhotoExif(make="Canon", model="Canon EOS 40D"), **changes), *SIZE, orientation)
    if gps:
        exif.get_ifd(ExifTags.IFD.GPSInfo).update(gps)
    exif.get_ifd(ExifTags.IFD.Exif).update(shot)
    picture = Image.fromarray(np.random.default_rng(1).integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8))
    block = Image.Exif()  # from bytes: Pillow writes directories that were filled by hand to JPEG only
    block.load(exif.tobytes())
    picture.save(folder / name, exif=block)
    return folder / name


def grey_of(file: Path, metadata: Metadata, folder: Path, file_format: Format) -> Path:
    """A grey file of the photograph's size with its EXIF, as `convert` writes it."""
    grey = np.zeros(stored_header(file)[1::-1], np.uint8)
    target = folder / f"grey{SUFFIXES[file_format]}"
    target.write_bytes(encode_image(grey, metadata.exif, file_format))
    return target


def camera(file: Path) -> tuple[Any, ...]:
    inferred = pycolmap.infer_camera_from_image(file)
    return (inferred.has_prior_focal_length, inferred.width, inferred.height, inferred.params.tolist())


@pytest.mark.parametrize("file_format", FORMATS)
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"focal_length_35mm": None},
        {"focal_length_mm": None, "focal_length_35mm": 28},
        {"focal_length_mm": None, "focal_length_35mm": None},
        {"make": "", "model": ""},
        {"orientation": 6},
        {"gps": GPS},
    ],
    ids=lambda changes: "+".join(changes) or "all",
)
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_colmap_infers_the_same_camera(
    tmp_path: Path, name: str, file_format: Format, changes: dict[str, Any]
) -> None:
    source = photograph(tmp_path, name, **changes)
    metadata = read_metadata(source, "coded")
    assert metadata.problem == ""
    assert camera(grey_of(source, metadata, tmp_path, file_format)) == camera(source)


def test_the_focal_prior_tells_these_photographs_apart(tmp_path: Path) -> None:
    """The comparison above can fail: 30 mm of 36 mm on 96 pixels is 80 pixels; unknown is 1.2 x 96."""
    nothing = {"focal_length_mm": None, "focal_length_35mm": None, "make": "", "model": ""}
    known, unknown = photograph(tmp_path), photograph(tmp_path, "b.jpg", **nothing)
    assert camera(known)[0]
    assert 70 < camera(known)[3][0] < 85
    assert not camera(unknown)[0]
    assert camera(unknown)[3][0] == pytest.approx(115.2)


def test_gps_counts_only_with_an_altitude(tmp_path: Path) -> None:
    """As in COLMAP, which wants latitude, longitude and altitude."""
    without = {tag: value for tag, value in GPS.items() if tag not in (5, 6)}
    assert read_metadata(photograph(tmp_path, gps=GPS), "coded").has_gps
    assert not read_metadata(photograph(tmp_path, "b.jpg", gps=without), "coded").has_gps
    assert not read_metadata(photograph(tmp_path, "c.jpg"), "coded").has_gps


@pytest.mark.parametrize(
    "changes",
    [
        {2: (R(0, 0), R(0, 0), R(0, 0))},
        {6: R(0, 0)},
        {2: (R(0), R(0), R(0)), 4: (R(0), R(0), R(0))},
        {2: (R(480), R(0), R(0))},
    ],
    ids=["latitude 0/0", "altitude 0/0", "0 north and east", "beyond the pole"],
)
def test_a_fix_that_no_place_has_is_none(tmp_path: Path, changes: dict[int, Any]) -> None:
    assert not read_metadata(photograph(tmp_path, gps=GPS | changes), "coded").has_gps


def test_a_fix_on_the_equator_is_one(tmp_path: Path) -> None:
    assert read_metadata(photograph(tmp_path, gps=GPS | {2: (R(0), R(0), R(0))}), "coded").has_gps


@pytest.mark.parametrize("file_format", FORMATS)
def test_a_maker_note_stays_where_it_fits_as_it_is(tmp_path: Path, file_format: Format) -> None:
    source = photograph(tmp_path, "a.png", shot={0x927C: bytes(66_000)})
    metadata = read_metadata(source, "coded")
    assert len(metadata.exif) > 66_000
    grey = grey_of(source, metadata, tmp_path, file_format)
    assert camera(grey) == camera(source)
    assert camera(grey)[0]
    with Image.open(grey) as image:
        inner = image.getexif().get_ifd(ExifTags.IFD.Exif)
        assert (0x927C in inner) == (file_format == "png")  # its offsets would be wrong in a TIFF


def test_other_exif_too_large_for_a_jpeg_goes_without_its_long_texts(tmp_path: Path) -> None:
    source = photograph(tmp_path, "a.png", shot={0x9286: b"a very long story " * 4000})
    grey = grey_of(source, read_metadata(source, "coded"), tmp_path, "jpeg")
    assert camera(grey) == camera(source)
    assert camera(grey)[0]


@pytest.mark.parametrize("file_format", FORMATS)
def test_a_photograph_without_exif_gives_a_grey_image_without(tmp_path: Path, file_format: Format) -> None:
    Image.new("RGB", SIZE).save(tmp_path / "a.png")
    metadata = read_metadata(tmp_path / "a.png", "coded")
    assert metadata == Metadata()
    assert camera(grey_of(tmp_path / "a.png", metadata, tmp_path, file_format)) == camera(tmp_path / "a.png")


def test_exif_of_a_preview_counts_where_the_raw_file_holds_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in Fujifilm's RAF; its preview may be half the size, and its focal plane is then of the preview."""
    plane = {0xA20E: 10 * SIZE[0] / 36, 0xA20F: 10 * SIZE[1] / 24, 0xA210: 3}
    exif = jpeg_exif(PhotoExif(focal_length_35mm=None), *SIZE)
    exif.get_ifd(ExifTags.IFD.Exif).update(plane)
    preview = BytesIO()
    Image.new("RGB", SIZE).save(preview, "JPEG", exif=exif)
    (tmp_path / "a.raf").write_bytes(b"FUJIFILMCCD-RAW " + bytes(100))
    monkeypatch.setattr(captures_metadata, "preview_of", lambda _: preview.getvalue())
    found = sized(decode_metadata(tmp_path / "a.raf", "raw"), 2 * SIZE[0], 2 * SIZE[1])
    assert (found.focal_mm, found.problem) == (30, "")
    assert found.pixels_per_mm == pytest.approx(2 * SIZE[0] / 36, rel=1e-5)


def test_what_libraw_knows_fills_in_a_raw_file_without_exif(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = LibrawMetadata(
        focal_mm=35.0, exposure_s=0.004, f_number=5.6, iso=200.0, lens="Rokkor 35", lens_make="Minolta"
    )
    (tmp_path / "a.mrw").write_bytes(b"\0MRM" + bytes(100))
    monkeypatch.setattr(captures_metadata, "preview_of", lambda _: b"")
    monkeypatch.setattr(captures_metadata, "libraw_metadata", lambda _: noted)
    found = decode_metadata(tmp_path / "a.mrw", "raw")
    assert (found.focal_mm, found.exposure_s, found.f_number, found.iso) == (35, 0.004, 5.6, 200)
    assert (found.lens, found.problem) == ("Rokkor 35", "")
    monkeypatch.setattr(captures_metadata, "libraw_metadata", lambda _: LibrawMetadata())
    assert decode_metadata(tmp_path / "a.mrw", "raw").problem == "no EXIF found"


@pytest.mark.data
def test_libraw_and_exif_agree_on_a_real_raw_file(photographs: Path) -> None:
    file = photographs / "raw/kodak_dc50.kdc"
    found, noted = read_metadata(file, "raw"), libraw_metadata(file)
    assert (found.make, found.problem) == ("Eastman Kodak Company", "")
    assert noted.focal_mm == pytest.approx(found.focal_mm)
    assert noted.exposure_s == pytest.approx(found.exposure_s)
    assert noted.f_number == pytest.approx(found.f_number)


def test_a_file_that_is_no_photograph_has_a_problem_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"no photograph")
    found = read_metadata(tmp_path / "a.jpg", "coded")
    assert "not readable" in found.problem
    assert replace(found, problem="") == Metadata()
    (tmp_path / "a.dng").write_bytes(b"no photograph")
    assert read_metadata(tmp_path / "a.dng", "raw").problem


@pytest.mark.data
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", ["exif/corrupted.jpg", "exif/image00971.jpg"])
def test_real_broken_exif(photographs: Path, tmp_path: Path, name: str) -> None:
    metadata = read_metadata(photographs / name, "coded")
    for file_format in FORMATS:
        with Image.open(grey_of(photographs / name, metadata, tmp_path, file_format)) as grey:
            grey.load()


@pytest.mark.data
def test_real_orientations(photographs: Path) -> None:
    """The orientations are in the names of the files."""
    for name, orientation in (("Landscape_3", 3), ("Landscape_8", 8), ("Portrait_6", 6)):
        assert read_metadata(photographs / f"exif/{name}.jpg", "coded").orientation == orientation
