"""The project folder: writes that are whole or not there, one run at a time, nothing of others touched."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stage_records import records

from colmap_ihe.errors import DiskFullError, ProjectError
from colmap_ihe.machine import files
from colmap_ihe.machine.files import fingerprint_of, read_json, replace_folder, write_bytes
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.project.folder import Project


def project(folder: Path) -> Project:
    (folder / "images").mkdir(parents=True, exist_ok=True)
    return Project.at(folder)


def everything(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


def test_a_write_makes_the_folders_above_and_leaves_nothing_else(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a/b/c.bin", b"content")
    assert (tmp_path / "a/b/c.bin").read_bytes() == b"content"
    write_bytes(tmp_path / "a/b/c.bin", b"other")
    assert (tmp_path / "a/b/c.bin").read_bytes() == b"other"
    assert everything(tmp_path) == ["a", "a/b", "a/b/c.bin"]


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize(
    ("code", "kind"),
    [
        *((errno.ENOSPC, DiskFullError), (errno.EDQUOT, DiskFullError)),
        *((errno.EACCES, ProjectError), (errno.EIO, ProjectError), (errno.EINVAL, OSError)),
    ],
)
def test_a_failed_write_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, code: int, kind: type[Exception]
) -> None:
    target = tmp_path / "a.bin"
    write_bytes(target, b"old")

    def fail(*_: Any) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os if step == "fsync" else Path, step, fail)
    with pytest.raises(kind) as caught:
        write_bytes(target, b"new")
    if kind is DiskFullError:
        assert str(target) in str(caught.value)
    assert target.read_bytes() == b"old"
    assert everything(tmp_path) == ["a.bin"]


def test_json_keeps_names_that_are_not_ascii_readable(tmp_path: Path) -> None:
    files.write_json(tmp_path / "a.json", {"façade/日本.jpg": [1, None]})
    assert "façade/日本.jpg" in (tmp_path / "a.json").read_text(encoding="utf-8")
    assert read_json(tmp_path / "a.json") == {"façade/日本.jpg": [1, None]}
    files.write_json(tmp_path / "a.json", {"half a character \ud800": "\udfffé"})
    assert read_json(tmp_path / "a.json") == {"half a character \ud800": "\udfffé"}


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[1]", b"3", b"\xff\xfe", b'{"a": 1', b"[" * 100_000, b'{"a": ' * 100_000, b"1" * 5000],
    ids=lambda content: content[:9],
)
def test_json_that_cannot_be_read_is_none(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.json").write_bytes(content)
    assert read_json(tmp_path / "a.json") is None
    assert read_json(tmp_path / "b.json") is None


def test_begin_tells_a_resumed_stage_from_a_new_one(tmp_path: Path) -> None:
    place = project(tmp_path)
    assert not place.was_begun("fit", "one")
    place.begin("fit", "one")
    assert place.was_begun("fit", "one")
    assert not place.was_begun("fit", "two")
    record = records()["fit"] | {"fingerprint": "one"}
    place.write_record("fit", record)
    assert not place.was_begun("fit", "one")  # finished: what it left is not half of anything
    assert read_record(place, "fit") == record
    place.begin("fit", "one")
    place.drop_record("fit")
    assert not place.was_begun("fit", "one")
    assert read_record(place, "fit") is None


def _hold(folder: str, ready: Any) -> None:
    with Project.at(Path(folder)).locked():
        ready.set()
        time.sleep(60)


def test_a_project_is_locked_while_another_process_works_and_free_when_it_is_killed(tmp_path: Path) -> None:
    place = project(tmp_path)
    spawn = multiprocessing.get_context("spawn")
    ready = spawn.Event()
    other = spawn.Process(target=_hold, args=(str(tmp_path), ready))
    other.start()
    try:
        assert ready.wait(60)
        with pytest.raises(ProjectError, match="another run is working on this project"), place.locked():
            pass
        with pytest.raises(ProjectError, match="another run"):
            (tmp_path / "images/a.jpg").touch()
            reconstruct(tmp_path)
    finally:
        other.kill()
        other.join(10)
        other.close()
    for _ in range(2):
        with place.locked():
            pass


def test_there_must_be_a_folder_of_photographs(tmp_path: Path) -> None:
    for root in (tmp_path / "missing", tmp_path, tmp_path):
        with pytest.raises(ProjectError, match="no such folder of photographs") as caught:
            Project.at(root)
        assert "--images" in caught.value.hint
        assert not (tmp_path / "missing").exists()
        (tmp_path / "images").touch()
    (tmp_path / "photos").mkdir()
    with pytest.raises(ProjectError, match="is a file"):
        Project.at(tmp_path / "images", tmp_path / "photos")
    assert Project.at(tmp_path / "new", tmp_path / "photos").images == tmp_path / "photos"


@pytest.mark.parametrize(
    ("name", "failed_before"),
    [("workspace", False), ("workspace", True), ("colour", False), ("report", False)],
)
def test_a_folder_that_we_did_not_make_is_refused_and_left_alone(
    tmp_path: Path, name: str, failed_before: bool
) -> None:
    """Also after a run without photographs has failed, whose lock has made records/."""
    project(tmp_path)
    if failed_before:
        with pytest.raises(ProjectError, match="no photograph found, it is empty"):
            reconstruct(tmp_path)
    (tmp_path / "images/a.jpg").touch()
    (tmp_path / name).mkdir()
    (tmp_path / name / "thesis.txt").write_text("mine")
    before = everything(tmp_path)
    with pytest.raises(ProjectError, match=f"{name}: is there already and was not made by colmap-ihe"):
        reconstruct(tmp_path)
    assert everything(tmp_path) == before
    assert (tmp_path / name / "thesis.txt").read_text() == "mine"


def test_a_folder_takes_the_place_of_another(tmp_path: Path) -> None:
    for name in ("new", "final"):
        (tmp_path / name / "0").mkdir(parents=True)
        (tmp_path / name / "0" / name).touch()
    replace_folder(tmp_path / "new", tmp_path / "final")
    assert everything(tmp_path) == ["final", "final/0", "final/0/new"]
    (tmp_path / "new").mkdir()
    (tmp_path / ".final.old").mkdir()  # of a run that was killed here
    replace_folder(tmp_path / "new", tmp_path / "final")
    assert everything(tmp_path) == ["final"]
    (tmp_path / "new").mkdir()
    (tmp_path / "final").rmdir()
    replace_folder(tmp_path / "new", tmp_path / "final")
    assert everything(tmp_path) == ["final"]


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


@given(plain, plain)
def test_fingerprints_are_equal_for_equal_values_only(one: Any, other: Any) -> None:
    same = json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)
    assert (fingerprint_of(one) == fingerprint_of(other)) == same
    assert fingerprint_of(one) == fingerprint_of(json.loads(json.dumps(one)))


def test_fingerprints_do_not_depend_on_the_order_of_keys_or_the_process() -> None:
    """Golden: blake2b, 12 bytes, of the JSON text `["stage", {"a": 1, "b": [2.5, null]}]`."""
    import hashlib

    golden = hashlib.blake2b(b'["stage", {"a": 1, "b": [2.5, null]}]', digest_size=12).hexdigest()
    assert fingerprint_of("stage", {"b": [2.5, None], "a": 1}) == golden


def test_digests_are_of_the_content(tmp_path: Path) -> None:
    for name, content in (("a", b"x" * 3_000_000), ("b", b"x" * 3_000_000), ("c", b"x" * 2_999_999 + b"y")):
        (tmp_path / name).write_bytes(content)
    a, b, c = (files.digest_file(tmp_path / n) for n in "abc")
    assert a == b != c
