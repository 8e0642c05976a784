"""Links, where the disk has them, and copies where it has none."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

import pytest

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import files
from colmap_ihe.machine.files import link_or_copy_folder


def refuse(*_: object, **__: object) -> None:
    raise OSError(errno.EOPNOTSUPP, "Operation not supported")


@pytest.mark.parametrize("has_links", [pytest.param(True, marks=pytest.mark.posix), False])
def test_a_folder_is_linked_or_copied_as_it_is_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_links: bool
) -> None:
    source, target = tmp_path / "masks", tmp_path / "target"
    source.mkdir()
    (source / "a.png").write_text("old")
    if not has_links:
        monkeypatch.setattr(os, "symlink", refuse)
    link_or_copy_folder(source, target)
    assert target.is_symlink() == has_links
    (source / "a.png").write_text("new")
    (source / "b.png").write_text("more")
    link_or_copy_folder(source, target)
    assert {file.name: file.read_text() for file in target.iterdir()} == {"a.png": "new", "b.png": "more"}


def _denied(winerror: int) -> PermissionError:
    error = PermissionError(errno.EACCES, "being used by another process", "model.ply")
    error.winerror = winerror  # type: ignore[attr-defined]
    return error


def test_a_file_that_a_viewer_holds_open_is_replaced_once_it_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Windows has it; anything else that is denied is raised at once."""
    replace, waits, refused = Path.replace, list[float](), [_denied(32), _denied(5), _denied(33)]

    def held(source: Path, target: Path) -> Path:
        if refused:
            raise refused.pop()
        return replace(source, target)

    monkeypatch.setattr(time, "sleep", waits.append)
    monkeypatch.setattr(Path, "replace", held)
    files.write_bytes(tmp_path / "a.ply", b"new")
    assert (tmp_path / "a.ply").read_bytes() == b"new"
    assert len(waits) == 3
    refused[:] = [PermissionError(errno.EACCES, "denied", "a.ply")]
    with pytest.raises(ProjectError, match=r"a\.ply: not writable"):
        files.write_bytes(tmp_path / "a.ply", b"other")
    assert len(waits) == 3
    refused[:] = [_denied(32) for _ in range(99)]
    with pytest.raises(ProjectError, match=r"model\.ply: another program has it open") as raised:
        files.write_bytes(tmp_path / "a.ply", b"other")
    assert "close viewers" in raised.value.hint
    assert 3 < sum(waits) < 10
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize(
    "name", ["con", "NUL.png", "com1", "Lpt9.tif", "aux .x", "a.", "b ", 'a"b', "a|b", "c:d", "a\\b"]
)
def test_names_that_windows_keeps_for_itself(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not files.is_name_of_windows(name)
    assert files.is_name_below(f"sub/{name}")
    monkeypatch.setattr(os, "name", "nt")
    assert not files.is_name_below(f"sub/{name}")


@pytest.mark.parametrize(
    "name", ["console", "a.con", "nul1", "COM10", "IMG_0001.JPG", ".hidden", "ä ö.png", "com0"]
)
def test_names_that_windows_can_have(name: str) -> None:
    assert files.is_name_of_windows(name)


def test_a_path_that_is_too_long_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match="this path is too long for the system"):
        files.write_bytes(tmp_path / ("a" * 200) / ("b" * 300) / "c.png", b"")
