"""Links, where the disk has them, and copies where it has none."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from colmap_ihe.machine.files import link_or_copy_folder


def refuse(*_: object, **__: object) -> None:
    raise OSError(errno.EOPNOTSUPP, "Operation not supported")


@pytest.mark.parametrize("has_links", [True, False])
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
