"""RAW photographs that are developed once."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from colmap_ihe.photographs import developed_cache as keep
from colmap_ihe.photographs.decode import decode_photograph, read_photograph
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.project.recipe import Recipe


@pytest.fixture
def capture(small_demo: Path, tmp_path: Path) -> Capture:
    (tmp_path / "images").mkdir()
    shutil.copy2(small_demo / "images/portico_01.dng", tmp_path / "images")
    (found,) = discover(tmp_path / "images").captures
    return replace(found, pixels=10**6, recipe=Recipe(cache_folder=str(tmp_path / "kept")))


def test_the_second_reading_is_of_what_was_kept(capture: Capture, tmp_path: Path) -> None:
    first = read_photograph(capture)
    (file,) = (tmp_path / "kept").iterdir()
    again = read_photograph(capture)
    np.testing.assert_array_equal(again.rgb, first.rgb)
    np.testing.assert_array_equal(np.asarray(again.srgb_from_camera), np.asarray(first.srgb_from_camera))
    assert again.encoding == "linear"
    keep.store(file, first.rgb // 2, first.srgb_from_camera)
    np.testing.assert_array_equal(read_photograph(capture).rgb, first.rgb // 2)


def test_another_recipe_and_another_file_are_another_thing(capture: Capture) -> None:
    files = {keep.kept_file(capture)}
    files.add(keep.kept_file(replace(capture, recipe=replace(capture.recipe, demosaic="ahd"))))
    content = capture.path.read_bytes()
    capture.path.write_bytes(content + b"0")
    files.add(keep.kept_file(capture))
    assert len(files) == 3
    assert keep.kept_file(replace(capture, recipe=Recipe())) is None
    assert replace(capture.recipe).identity() == Recipe().identity()


@pytest.mark.parametrize("content", [b"", b"PK nothing", None])
def test_what_is_broken_is_developed_again(capture: Capture, content: bytes | None) -> None:
    whole = read_photograph(capture).rgb
    file = keep.kept_file(capture)
    assert file is not None
    kept = file.read_bytes()
    middle = len(kept) // 2
    flipped = kept[:middle] + bytes([kept[middle] ^ 1]) + kept[middle + 1 :]
    file.write_bytes(flipped if content is None else content)
    np.testing.assert_array_equal(read_photograph(capture).rgb, whole)
    assert file.read_bytes() == kept


def test_nothing_is_kept_where_there_is_little_room(
    capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=10**5))
    file = keep.kept_file(capture)
    assert file is not None
    decode_photograph(capture)
    assert not list((tmp_path / "kept").iterdir())
