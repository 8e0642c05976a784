"""What is left out is named with its folder, with the cause and what to do about it."""

from __future__ import annotations

import errno
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from colmap_ihe.errors import PhotographError, ProjectError
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.decode import decode_size
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.photographs.each import leave_out, none_usable
from colmap_ihe.photographs.survey import survey


def test_two_folders_of_a_card_are_told_apart(tmp_path: Path) -> None:
    for folder in ("100CANON", "101CANON"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "IMG_0001.CR2").write_bytes(b"II*\0" + bytes(99))
        (tmp_path / folder / "IMG_0002.JPG").write_bytes(bytes(99))
    with ThreadPoolExecutor(1) as threads, pytest.raises(ProjectError) as raised:
        survey(discover(tmp_path).captures, threads, SILENT, strict=False)
    message = str(raised.value)
    assert message.startswith(
        "none of the 4 photographs can be used: 100CANON/IMG_0001.CR2: LibRaw cannot read"
    )
    assert "; 100CANON/IMG_0002.JPG: cannot be read" in message
    assert message.endswith(" and 1 more")
    with (
        pytest.raises(PhotographError, match=r"^100CANON/IMG_0001\.CR2: LibRaw"),
        ThreadPoolExecutor(1) as threads,
    ):
        survey(discover(tmp_path).captures, threads, SILENT, strict=True)


def test_the_folder_is_not_said_twice(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").touch()
    for name, words in (("a.jpg", "a.jpg: is odd"), ("x/a.jpg", "x/a.jpg: is odd")):
        left_out: dict[str, str] = {}
        leave_out(Capture(name, tmp_path / "a.jpg", "coded", "a"), PhotographError(words), False, left_out)
        assert left_out == {name: words}


def test_what_was_refused_before_counts_among_those_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"")
    (tmp_path / "b.jpg").symlink_to(tmp_path / "nowhere.jpg")
    (tmp_path / "c\x07.jpg").touch()
    found = discover(tmp_path)
    with ThreadPoolExecutor(1) as threads, pytest.raises(ProjectError) as raised:
        survey(found.captures, threads, SILENT, strict=False, refused=found.refused)
    assert str(raised.value) == (
        "none of the 3 photographs can be used: b.jpg: cannot be read (a link to nowhere);"
        " c\\x07.jpg: its name holds control characters, or is not UTF-8 text; a.jpg: cannot be read (it is empty)"
    )
    assert raised.value.hint == (
        "put the photograph in its place; or rename it; or copy it from the card again, or take it out of the folder"
    )


def test_the_other_half_of_a_shot_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(bytes(99))
    (tmp_path / "a.jpg").touch()
    with ThreadPoolExecutor(1) as threads, pytest.raises(ProjectError, match="the only photograph") as raised:
        survey(discover(tmp_path).captures, threads, SILENT, strict=False)
    assert raised.value.hint.endswith("or take it out of the folder; without it a.jpg is used")


def test_one_photograph_is_no_plural() -> None:
    error = none_usable({"a.jpg": "a.jpg: is odd; take it out"})
    assert (str(error), error.hint) == ("the only photograph cannot be used: a.jpg: is odd", "take it out")


@pytest.mark.parametrize("name", ["a.jpg", "a.dng"])
def test_a_file_without_permission_is_no_damaged_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / name).write_bytes(b"II*\0" + bytes(99))
    (capture,) = discover(tmp_path).captures

    def refuse(path: Path, *_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(PhotographError, match=f"^{name}: cannot be read .Permission denied.$") as raised:
        decode_size(capture)
    assert raised.value.hint == "give read permission"
