"""Which files are captures, what pairs with what, and what the grey images are called."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from colmap_ihe.errors import PhotographError, ProjectError
from colmap_ihe.machine.files import is_name_below
from colmap_ihe.photographs.decode import read_size
from colmap_ihe.photographs.discover import Capture, discover


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def by_name(folder: Path) -> dict[str, Capture]:
    return {capture.name: capture for capture in discover(folder).captures}


def test_raw_and_jpeg_of_one_shot_count_once_and_raw_wins(tmp_path: Path) -> None:
    touched(tmp_path, "a.NEF", "a.JPG", "b.jpg", "c.dng", "d.CR2", "d.jpeg")
    found = by_name(tmp_path)
    assert list(found) == ["a.NEF", "b.jpg", "c.dng", "d.CR2"]
    assert [c.kind for c in found.values()] == ["raw", "coded", "raw", "raw"]
    assert [c.paired for c in found.values()] == [("a.JPG",), (), (), ("d.jpeg",)]
    assert [c.grey_stem for c in found.values()] == ["a", "b", "c", "d"]


@pytest.mark.parametrize(
    ("names", "stems", "paired"),
    [
        (
            ["raw/a.nef", "jpeg/a.jpg"],
            {"raw/a.nef": "raw/a"},
            ("jpeg/a.jpg",),
        ),  # of folders called after kinds
        (["1/RAW/a.nef", "1/JPG/a.jpg"], {"1/RAW/a.nef": "1/RAW/a"}, ("1/JPG/a.jpg",)),
        (["a.nef", "JPG/a.jpg"], {"a.nef": "a"}, ("JPG/a.jpg",)),
        (["1/RAW/a.nef", "2/JPG/a.jpg"], {"1/RAW/a.nef": "1/RAW/a", "2/JPG/a.jpg": "2/JPG/a"}, ()),
        (["nef/a.jpg", "jpg/a.nef"], {"jpg/a.nef": "jpg/a", "nef/a.jpg": "nef/a"}, ()),  # of the wrong kinds
        (["north/a.nef", "south/a.jpg"], {"north/a.nef": "north/a", "south/a.jpg": "south/a"}, ()),
        (["jpg/a.jpg", "a.jpg"], {"a.jpg": "a", "jpg/a.jpg": "jpg/a"}, ()),
        (["a.nef", "a.jpg", "a.tif"], {"a.nef": "a.nef", "a.tif": "a.tif"}, ("a.jpg",)),  # but not a TIFF
        (["shot.01.jpg", "shot.02.jpg"], {"shot.01.jpg": "shot.01", "shot.02.jpg": "shot.02"}, ()),
        (["a.png", "a.tif", "other.jpg"], {"a.png": "a.png", "a.tif": "a.tif", "other.jpg": "other"}, ()),
        (["a.png", "A.tif"], {"A.tif": "A.tif", "a.png": "a.png"}, ()),
        (["x/a.jpg", "x/a.png"], {"x/a.jpg": "x/a.jpg", "x/a.png": "x/a.png"}, ()),
        (["a.nef", "a.dng"], {"a.dng": "a.dng", "a.nef": "a.nef"}, ()),
        (["Ä.png", "ä.tif"], {"Ä.png": "Ä.png", "ä.tif": "ä.tif"}, ()),
    ],
)
def test_what_pairs_and_what_would_collide(
    tmp_path: Path, names: list[str], stems: dict[str, str], paired: tuple[str, ...]
) -> None:
    found = by_name(touched(tmp_path, *names))
    assert {name: capture.grey_stem for name, capture in found.items()} == stems
    assert sum((capture.paired for capture in found.values()), ()) == paired


def test_subfolders_spaces_and_non_ascii_names_are_kept(tmp_path: Path) -> None:
    names = ["façade nord/Été 01.jpg", "façade nord/портик.png", "a b/c d/e f.tiff", "日本.JPG"]
    found = by_name(touched(tmp_path, *names))
    assert sorted(found) == sorted(names)
    for name, capture in found.items():
        assert capture.path == tmp_path / name
        assert capture.grey_stem == name.rpartition(".")[0]


@pytest.mark.parametrize(
    "name",
    [
        "Screenshot 2024-01-01 at 10.00.00\u202fAM.png",  # as macOS writes it
        "写真\u30001.jpg",
        "a\u00a0b.jpg",
        "می\u200cخواهم.jpg",
        "क्\u200dष.jpg",
        "👩\u200d🚀.jpg",
        "co\u00adop.jpg",
        "two  spaces.jpg",
    ],
    ids=[
        "narrow space",
        "ideographic space",
        "no-break",
        "non-joiner",
        "joiner",
        "emoji",
        "soft hyphen",
        "spaces",
    ],
)
def test_names_of_every_script_are_photographs(tmp_path: Path, name: str) -> None:
    touched(tmp_path, name)
    found = discover(tmp_path)
    assert [c.name for c in found.captures] == [name]
    assert found.refused == {}
    assert is_name_below(found.captures[0].grey_stem + ".png")
    with pytest.raises(PhotographError) as raised:
        read_size(found.captures[0])
    assert str(raised.value).startswith(f"{name}: ")


def test_names_that_are_no_text_leave_out_their_photograph_alone(tmp_path: Path) -> None:
    touched(tmp_path, "a.jpg", "b\x07.jpg", "c\n/d.jpg", "note\r.txt", "Icon\r")
    (tmp_path / os.fsdecode(b"e\xff.jpg")).touch()
    found = discover(tmp_path)
    assert [c.name for c in found.captures] == ["a.jpg"]
    assert sorted(found.refused) == ["b\\x07.jpg", "c\\n/d.jpg", "e\\udcff.jpg"]
    assert found.refused["b\\x07.jpg"].startswith("b\\x07.jpg: its name holds control characters")
    assert found.ignored == ("note\\r.txt",)


def test_a_name_kept_for_its_extension_does_not_collide_in_turn(tmp_path: Path) -> None:
    """`a.png` and `a.tif` become a.png and a.tif; the stem of `a.png.jpg` is a.png as well."""
    found = by_name(touched(tmp_path, "a.png", "a.tif", "a.png.jpg"))
    stems = [c.grey_stem.casefold() for c in found.values()]
    assert len(set(stems)) == len(stems) == 3


def test_suffixes_are_read_in_any_case(tmp_path: Path) -> None:
    found = by_name(touched(tmp_path, "a.JpG", "b.DNG", "c.TIFF", "d.Png", "e.Cr3"))
    assert [c.kind for c in found.values()] == ["coded", "raw", "coded", "coded", "raw"]


def test_hidden_files_and_folders_are_passed_over(tmp_path: Path) -> None:
    touched(tmp_path, "a.jpg", "._a.jpg", ".hidden/b.jpg", "c/.d.jpg", "c/e.jpg", ".DS_Store")
    found = discover(tmp_path)
    assert [c.name for c in found.captures] == ["a.jpg", "c/e.jpg"]
    assert found.ignored == ()


RUBBISH = [
    "@eaDir/a.jpg/SYNOPHOTO_THUMB_XL.jpg", "#recycle/a.jpg", "$RECYCLE.BIN/S-1/a.jpg", ".Trash-1000/files/a.jpg",
    "lost+found/a.jpg", "__MACOSX/._a.jpg", ".thumbnails/normal/a.png", "north/@eadir/a.jpg", "._a.jpg",
]  # fmt: skip


@pytest.mark.parametrize("name", RUBBISH)
def test_what_systems_keep_in_folders_is_no_photograph_and_told(tmp_path: Path, name: str) -> None:
    touched(tmp_path, "a.jpg", "north/b.jpg", name)
    found = discover(tmp_path)
    assert [c.name for c in found.captures] == ["a.jpg", "north/b.jpg"]
    (note,) = found.notes
    assert note.startswith("passed over, as no photographs of the set: ")
    assert name.startswith(note.rpartition(": ")[2])


def test_all_of_it_is_one_line(tmp_path: Path) -> None:
    found = discover(touched(tmp_path, "a.jpg", *RUBBISH))
    (note,) = found.notes
    assert note.endswith(" and 4 more")


def test_one_shot_in_two_folders_is_told(tmp_path: Path) -> None:
    found = discover(touched(tmp_path, "RAW/a.nef", "JPG/a.jpg", "RAW/b.nef", "JPG/b.jpg"))
    assert [c.name for c in found.captures] == ["RAW/a.nef", "RAW/b.nef"]
    (note,) = found.notes
    assert note.startswith(
        "2 JPEG files in a folder beside the RAW files of the same names, as JPG/a.jpg of RAW/a.nef"
    )


def test_a_folder_of_the_system_that_nobody_may_read_is_no_obstacle(tmp_path: Path) -> None:
    touched(tmp_path, "a.jpg", "lost+found/b.jpg")
    (tmp_path / "lost+found").chmod(0)
    try:
        assert [c.name for c in discover(tmp_path).captures] == ["a.jpg"]
    finally:
        (tmp_path / "lost+found").chmod(0o700)


def test_other_files_are_ignored_and_named(tmp_path: Path) -> None:
    touched(tmp_path, "a.jpg", "a.xmp", "notes.txt", "x/Thumbs.db", "film.mp4")
    assert discover(tmp_path).ignored == ("a.xmp", "film.mp4", "notes.txt", "x/Thumbs.db")


def test_the_order_is_that_of_the_names(tmp_path: Path) -> None:
    names = ["b/1.jpg", "a/2.jpg", "c.jpg", "A.jpg", "a/10.jpg"]
    assert list(by_name(touched(tmp_path, *names))) == sorted(names)


def test_no_photograph_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match=r"no photograph found, it is empty") as caught:
        discover(tmp_path)
    assert "RAW, JPEG, HEIC, TIFF or PNG" in caught.value.hint
    touched(tmp_path, "a.txt", "b/c.pdf")
    with pytest.raises(ProjectError, match="it holds 2 other files"):
        discover(tmp_path)
    with pytest.raises(ProjectError, match="no such folder"):
        discover(tmp_path / "nowhere")
    with pytest.raises(ProjectError, match="no such folder"):
        discover(tmp_path / "a.txt")
