"""RAW files of a format that LibRaw does not know, beside the sound JPEG of each shot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dngs import write_kind
from PIL import Image

from colmap_ihe.errors import PhotographError
from colmap_ihe.photographs.decode import read_photograph, read_size
from colmap_ihe.photographs.discover import captures_of_files
from colmap_ihe.photographs.readable import find_photographs, with_readable_halves

JPEG_XL, VC_5 = 52546, 9
CELL = np.array([list("RG"), list("GB")])


def shot(folder: Path, stem: str, *, compression: int = 1, model: str = "Phone", jpeg: bool = True) -> None:
    """A DNG of 80x80, and its JPEG with one colour."""
    folder.mkdir(parents=True, exist_ok=True)
    values = np.full((80, 80), 9000, np.uint16)
    write_kind(folder / f"{stem}.DNG", values, pattern=CELL, model=model, tags={259: compression})
    if jpeg:
        Image.new("RGB", (80, 80), (90, 100, 110)).save(folder / f"{stem}.JPG")


@pytest.mark.parametrize("compression", [JPEG_XL, VC_5])
def test_the_jpeg_stands_in_for_a_format_that_is_not_known(tmp_path: Path, compression: int) -> None:
    for number in range(4):
        shot(tmp_path, f"IMG_{number}", compression=compression)
    found = find_photographs(tmp_path)
    assert [c.name for c in found.captures] == [f"IMG_{number}.JPG" for number in range(4)]
    assert {(c.kind, c.grey_stem, c.paired) for c in found.captures} == {
        ("coded", c.grey_stem, ()) for c in found.captures
    }
    assert [c.grey_stem for c in found.captures] == [f"IMG_{number}" for number in range(4)]
    assert read_photograph(found.captures[2]).rgb[40, 40].tolist() == pytest.approx([90, 100, 110], abs=2)
    (note,) = found.notes
    assert note.startswith(
        "the RAW files of Test Phone are of a format that LibRaw does not know, as IMG_0.DNG ("
    )
    assert "its JPEG files are used, of 4 shots" in note


def test_one_camera_has_one_kind_in_all_its_folders(tmp_path: Path) -> None:
    """One shot in a compression that LibRaw does not know makes all of its camera JPEG, and none of another's."""
    shot(tmp_path / "100", "IMG_1")
    shot(tmp_path / "101", "IMG_2", compression=JPEG_XL)
    shot(tmp_path / "101", "IMG_3", model="Other")
    shot(tmp_path / "102", "IMG_4", jpeg=False)
    names = [c.name for c in find_photographs(tmp_path).captures]
    assert names == ["100/IMG_1.JPG", "101/IMG_2.JPG", "101/IMG_3.DNG", "102/IMG_4.DNG"]


def test_sound_raw_files_stay(tmp_path: Path) -> None:
    for number in range(3):
        shot(tmp_path, f"IMG_{number}")
    found = find_photographs(tmp_path)
    assert [(c.name, c.paired) for c in found.captures] == [
        (f"IMG_{number}.DNG", (f"IMG_{number}.JPG",)) for number in range(3)
    ]
    assert found.notes == ()


def test_a_damaged_raw_file_is_no_unknown_format(tmp_path: Path) -> None:
    for number in range(3):
        shot(tmp_path, f"IMG_{number}")
    (tmp_path / "IMG_0.DNG").write_bytes(bytes(5000))
    found = find_photographs(tmp_path)
    assert [c.name for c in found.captures] == [f"IMG_{number}.DNG" for number in range(3)]
    with pytest.raises(PhotographError) as raised:
        read_size(found.captures[0])
    assert "copy it from the card again" in raised.value.hint
    assert "maker" not in raised.value.hint


def test_the_hint_for_an_unknown_format_is_to_convert_it(tmp_path: Path) -> None:
    shot(tmp_path, "IMG_0", compression=JPEG_XL, jpeg=False)
    with pytest.raises(PhotographError, match=r"IMG_0.DNG: LibRaw cannot read this RAW file") as raised:
        read_photograph(find_photographs(tmp_path).captures[0])
    assert "convert it to DNG or TIFF with the maker's program" in raised.value.hint


def test_files_of_a_fit_too(tmp_path: Path) -> None:
    shot(tmp_path, "IMG_0", compression=JPEG_XL)
    files = captures_of_files([tmp_path / "IMG_0.DNG", tmp_path / "IMG_0.JPG"])
    (capture,), (note,) = with_readable_halves(files)
    assert (capture.path, capture.name) == (tmp_path / "IMG_0.JPG", (tmp_path / "IMG_0.JPG").as_posix())
    assert "of 1 shot." in note
