"""Files that are no photographs are named as what they are, with what to do."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from colmap_ihe.errors import PhotographError, ProjectError
from colmap_ihe.photographs.decode import read_size
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.file_kinds import (
    _ADVICE,
    _HEADS,
    _SUFFIXES,
    advice_on,
    kind_by_content,
    unread_files,
)


def test_each_kind_is_one_sentence_with_what_to_do() -> None:
    webp, film = unread_files(["a.webp", "b.WEBP", "x/c.MOV", "notes.txt", "d.xmp"], [])
    assert webp == f"2 WebP pictures cannot be used, a.webp, b.WEBP: {advice_on('WebP picture')}"
    assert film.startswith("1 film cannot be used, x/c.MOV: take single frames from it")


def test_the_films_of_a_phones_photographs_are_no_loss() -> None:
    assert unread_files(["IMG_1.MOV"], ["IMG_1.HEIC"]) == []
    assert len(unread_files(["IMG_1.MOV"], ["x/IMG_1.HEIC"])) == 1


def test_every_kind_has_advice() -> None:
    assert set(_ADVICE) == {kind for _, kind in _HEADS} | set(_SUFFIXES)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"8BPS\0\1", "Photoshop file"),
        (b"\0\0\0\x20ftypavif", "AVIF picture"),
        (b"\0\0\0\x14ftypqt  ", "film"),
        (b"\0\0\0\x18ftypheic", ""),
        (b"", ""),
    ],
)
def test_a_kind_by_its_first_bytes(tmp_path: Path, content: bytes, kind: str) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    assert kind_by_content(tmp_path / "a.jpg") == kind


def test_another_kind_under_the_name_of_a_photograph(tmp_path: Path) -> None:
    Image.new("RGB", (80, 80)).save(tmp_path / "a.jpg", format="WEBP")
    with pytest.raises(PhotographError, match=r"^a\.jpg: is a WebP picture, whatever its name$") as raised:
        read_size(discover(tmp_path).captures[0])
    assert raised.value.hint == advice_on("WebP picture")


def test_a_folder_of_nothing_else_says_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "a.webp").touch()
    (tmp_path / "b.txt").touch()
    with pytest.raises(
        ProjectError, match=r"no photograph found, 1 WebP picture cannot be used, a\.webp: save it as"
    ):
        discover(tmp_path)
