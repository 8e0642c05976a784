"""Mappers in a process of their own: what they find, how they are stopped, and what is said when they fail."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from processes import children

from colmap_ihe.colmap import mapping_process as mapping_apart
from colmap_ihe.colmap.mapping_process import map_apart, pipeline_options
from colmap_ihe.errors import Cancelled, NativeError, OptionError
from colmap_ihe.machine.progress import SILENT, Progress, Silent


def mappers() -> list[int]:
    return [pid for pid in children() if b"colmap.process" in Path(f"/proc/{pid}/cmdline").read_bytes()]


class After(Silent):
    """Does something when asked for the first time after `seconds`."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.end = time.monotonic() + seconds

    def check(self) -> None:
        if time.monotonic() > self.end:
            self.now()

    def now(self) -> None:
        raise Cancelled


class Kills(After):
    def now(self) -> None:
        for pid in mappers():
            os.kill(pid, signal.SIGKILL)


def sleep(_request: object, _progress: Progress) -> None:
    time.sleep(60)


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mapping takes its time: of so few photographs it can be over before anybody looks."""
    monkeypatch.setattr(mapping_apart, "_map", sleep)


@pytest.fixture
def places(finished: Path, tmp_path: Path) -> tuple[Path, Path, Path]:
    (tmp_path / "out").mkdir()
    return finished / "workspace/database.db", finished / "workspace/images", tmp_path / "out"


@pytest.mark.usefixtures("slow")
def test_stopped_at_once(places: tuple[Path, Path, Path]) -> None:
    began = time.monotonic()
    with pytest.raises(Cancelled):
        map_apart("hierarchical", *places, {}, 0, After(0.3))
    assert time.monotonic() - began < 10
    assert mappers() == []


@pytest.mark.usefixtures("slow")
def test_killed_by_the_system(places: tuple[Path, Path, Path]) -> None:
    with pytest.raises(NativeError, match=r"died .SIGKILL, perhaps for want of memory"):
        map_apart("hierarchical", *places, {}, 0, Kills(0.3))


def test_what_colmap_refuses_is_told(places: tuple[Path, Path, Path]) -> None:
    with pytest.raises(OptionError, match=r"sparse\.colmap: .*no_such_option"):
        map_apart("hierarchical", *places, {"no_such_option": 1}, 0, SILENT)


def test_the_hierarchical_mapper_takes_the_options_of_the_incremental_one() -> None:
    values = {
        "num_workers": 3,
        "ba_refine_focal_length": False,
        "min_num_matches": 11,
        "incremental_options": {"min_num_matches": 12, "min_model_size": 4},
    }
    found = pipeline_options("hierarchical", values)
    assert found.num_workers == 3
    parts = found.incremental_options
    assert (parts.ba_refine_focal_length, parts.min_num_matches, parts.min_model_size) == (False, 12, 4)
    assert parts.ba_refine_extra_params
    for wrong in (
        {"no_such_option": 1},
        {"ba_refine_focal_length": "perhaps"},
        {"ba_refine_focal_length": False, "incremental_options": 5},
    ):
        with pytest.raises(OptionError, match=r"sparse\.colmap"):
            pipeline_options("hierarchical", wrong)
