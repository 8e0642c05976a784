"""Mappers in a process of their own: how they are stopped, and what they refuse."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from running import StopsWhen

from colmap_ihe.colmap import mapping
from colmap_ihe.colmap.mapping import MappingInput, map_in_process, native_options
from colmap_ihe.errors import Cancelled, OptionError
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import SparseOptions


def sleep(_given: MappingInput, _progress: Progress) -> None:
    time.sleep(60)


def given(project: Path, **values: object) -> MappingInput:
    options = SparseOptions(mapper="hierarchical", colmap=values)
    return MappingInput(project / "database.db", project / "images", project / "out", options, 8)


def test_stopped_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping, "_map", sleep)
    began = time.monotonic()
    with pytest.raises(Cancelled):
        map_in_process(given(tmp_path), StopsWhen(lambda _: time.monotonic() > began + 0.3))
    assert time.monotonic() - began < 10


def test_the_hierarchical_mapper_takes_the_options_of_the_incremental_one(tmp_path: Path) -> None:
    values: dict[str, object] = {"num_workers": 3, "ba_refine_focal_length": False, "min_num_matches": 11}
    values["incremental_options"] = {"min_num_matches": 12, "min_model_size": 4}
    settings = native_options(given(tmp_path, **values).options)
    assert settings.num_workers == 3
    parts = settings.incremental_options
    assert (parts.ba_refine_focal_length, parts.min_num_matches, parts.min_model_size) == (False, 12, 4)
    assert parts.ba_refine_extra_params
    for wrong in (
        {"no_such_option": 1},
        {"ba_refine_focal_length": "perhaps"},
        {"ba_refine_focal_length": False, "incremental_options": 5},
    ):
        with pytest.raises(OptionError, match=r"sparse\.colmap"):
            native_options(given(tmp_path, **wrong).options)
