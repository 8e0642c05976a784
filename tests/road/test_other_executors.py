"""Work given to workers that share no memory with us: the same files, features and matches."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
from same_results import contents, known_of
from small_demo import Make, MakeOptions

from colmap_ihe.errors import Cancelled, PhotographError
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import SILENT, Silent
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.recipes import with_recipes
from colmap_ihe.photographs.survey import survey
from colmap_ihe.pipeline.develop_folder import develop_folder
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import DevelopOptions


@pytest.fixture
def processes() -> Any:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        yield pool


@pytest.mark.slow
def test_processes_make_what_threads_make(
    new_project: Make, finished: Path, quick_options: MakeOptions, processes: Executor
) -> None:
    project = new_project()
    done = reconstruct(project, quick_options("mesh.enabled=false"), executor=processes)
    assert done.summary["registered_images"] == 8
    assert 20_000 < done.summary["dense_points"] < 80_000
    for folder in ("workspace/images", "colour"):
        assert contents(project / folder) == contents(finished / folder)
    for stage in ("convert", "matches", "dense"):  # whoever did it, it is done
        records = [read_record(Project.at(folder), stage) or {} for folder in (project, finished)]
        assert records[0]["fingerprint"] == records[1]["fingerprint"]
    one, other = (known_of(folder / "workspace/database.db") for folder in (project, finished))
    assert one == other
    assert len(one["verified"]) == 28
    assert not (project / "workspace/parts").exists()


def test_raw_recipes_and_broken_photographs(new_project: Make, processes: Executor, tmp_path: Path) -> None:
    project = new_project(4, (".dng",))
    (project / "images/broken.dng").write_bytes(b"II*\0nothing")
    captures = discover(project / "images").captures
    surveyed, left_out = survey(captures, processes, SILENT, strict=False)
    assert list(left_out) == ["broken.dng"]
    options = DevelopOptions(balance=True, find_bad_pixels=True)
    here = with_recipes(surveyed, options, None, tmp_path, processes, SILENT, strict=True)
    assert len({s.capture.recipe.gains for s in here.surveyed}) == 4
    with pytest.raises(PhotographError, match=r"broken\.dng"):
        survey(captures, processes, SILENT, strict=True)
    assert develop_folder(project / "images", tmp_path / "linear")[0].keys() == {
        f"portico_{n:02}.dng" for n in range(1, 5)
    }


class Never(Executor):
    """Whose workers never come to do anything."""

    def __init__(self) -> None:
        self.given: list[Future[Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.given.append(Future())
        return self.given[-1]


class Stopped(Silent):
    def check(self) -> None:
        raise Cancelled


def test_what_is_under_way_is_cancelled() -> None:
    executor = Never()
    with pytest.raises(Cancelled):
        list(in_order(executor, str, range(100), 4, Stopped()))
    assert len(executor.given) == 4
    assert all(future.cancelled() for future in executor.given)
