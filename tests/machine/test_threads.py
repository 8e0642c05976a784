"""A limit on threads, and what a run with one thread gives."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Thread

import cv2
import pytest
from small_demo import QUICK, Make
from threadpoolctl import threadpool_info

from colmap_ihe.colmap import matching
from colmap_ihe.colmap.mapper_options import native_options
from colmap_ihe.colmap.native import fill, pycolmap
from colmap_ihe.machine import threads
from colmap_ihe.machine.executor import local_executor, threads_of, width_of
from colmap_ihe.machine.threads import limit_openmp_of_this_thread, limited, local_workers
from colmap_ihe.project.options import MatchesOptions, SparseOptions

MADE = ("database.db", "sparse/0/*.bin", "images/*.png")
MADE_DENSE = ("dense/0/stereo/*_maps/*.bin", "dense/0/fused.ply*", "dense/0/mesh.*")


def pools(kind: str) -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == kind}


@pytest.fixture
def four_cores(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(threads, "cores", lambda: 4)
    before = cv2.getNumThreads()
    yield
    assert cv2.getNumThreads() == before


@pytest.mark.usefixtures("four_cores")
def test_a_limit_reaches_everything_and_ends() -> None:
    before = pools("blas"), pools("openmp")
    with limited(1):
        assert (local_workers(), cv2.getNumThreads(), pools("blas")) == (1, 1, {1})
        with local_executor() as executor:
            assert width_of(executor) == 1
        with limit_openmp_of_this_thread():
            assert pools("openmp") == {1}
        assert threads.environment() == {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    assert (local_workers(), threads.environment()) == (4, {})
    assert (pools("blas"), pools("openmp")) == before


@pytest.mark.usefixtures("four_cores")
def test_the_least_of_several_limits_counts_and_none_limits_nothing() -> None:
    with limited(3):
        with limited(None), limited(2):
            assert local_workers() == 2
        outer = limited(1)
        worker = Thread(target=outer.__enter__)
        worker.start()
        worker.join()
        assert local_workers() == 1
        outer.__exit__(None, None, None)
        assert local_workers() == 3
    with limited(64):
        assert local_workers() == 4


def test_colmap_is_told_wherever_it_decides_for_itself() -> None:
    with limited(1):
        incremental = native_options(SparseOptions(colmap={"mapper": {"num_threads": 3}}))
        pairs, pairing, _ = matching.native_options(MatchesOptions(), "vocabtree")
        hierarchical = native_options(SparseOptions(mapper="hierarchical"))
        everywhere = native_options(SparseOptions(mapper="global"))
    assert (incremental.num_threads, incremental.mapper.num_threads) == (1, 3)
    assert (pairs.num_threads, pairing.num_threads) == (1, 1)
    assert (hierarchical.num_workers, hierarchical.incremental_options.num_threads) == (1, 1)
    assert everywhere.mapper.bundle_adjustment.ceres.solver_options.num_threads == 1
    assert native_options(SparseOptions()).num_threads == -1


def test_a_seed_goes_wherever_colmap_would_choose_one() -> None:
    settings = pycolmap.GlobalPipelineOptions()
    settings.mapper.retriangulation.random_seed = 4
    fill(settings, {"random_seed": 9})
    mapper = settings.mapper
    seeds = (settings.random_seed, mapper.random_seed, mapper.rotation_averaging.random_seed)
    assert (*seeds, mapper.retriangulation.random_seed) == (9, 9, 9, 4)


def digests(project: Path, patterns: tuple[str, ...]) -> dict[str, str]:
    place = project / "workspace"
    found = [file for pattern in patterns for file in sorted(place.glob(pattern))]
    return {f.relative_to(place).as_posix(): hashlib.sha256(f.read_bytes()).hexdigest() for f in found}


def reconstruct(project: Path, *arguments: str) -> None:
    command = [sys.executable, "-m", "colmap_ihe", "reconstruct", str(project), "-q", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "the record is of" not in done.stderr


def again(project: Path, other: Path, *more: str) -> None:
    reconstruct(other, "--images", str(project / "images"), "--from-record", str(project), *more)


def settings(*more: str) -> list[str]:
    return [word for one in (*QUICK, "fit.measure=false", *more) for word in ("--set", one)]


def test_one_thread_gives_the_same_model_from_the_record_elsewhere(new_project: Make, tmp_path: Path) -> None:
    project, other = new_project(5), tmp_path / "somewhere" / "else"
    reconstruct(project, "--threads", "1", "--until", "sparse", *settings())
    again(project, other, "--until", "sparse")
    found = digests(project, MADE)
    assert len(found) == 1 + 5 + 5 and digests(other, MADE) == found


@pytest.mark.slow
def test_one_thread_gives_the_same_cloud_and_mesh(new_project: Make, tmp_path: Path) -> None:
    project, other = new_project(suffixes=(".dng",)), tmp_path / "other"
    reconstruct(project, "--threads", "1", *settings("sparse.seed=3"))
    again(project, other)
    found = digests(project, (*MADE, *MADE_DENSE))
    assert {"dense/0/fused.ply", "dense/0/fused.ply.vis", "dense/0/mesh.ply"} <= set(found)
    assert digests(other, (*MADE, *MADE_DENSE)) == found


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        ("sparse.mapper=global", "sparse.seed=3"),
        ("sparse.mapper=hierarchical", "sparse.seed=3"),
        ("matches.strategy=vocabtree",),
        ("matches.strategy=sequential", "matches.pairing.loop_detection=true"),
    ],
)
def test_one_thread_gives_the_same_model_however_it_is_found(
    new_project: Make, tmp_path: Path, how: tuple[str, ...]
) -> None:
    project, other = new_project(), tmp_path / "other"
    reconstruct(project, "--threads", "1", "--until", "sparse", *settings(*how))
    again(project, other, "--until", "sparse")
    found = digests(project, MADE)
    assert "sparse/0/points3D.bin" in found and digests(other, MADE) == found


def test_blas_has_one_thread_while_others_compute() -> None:
    threads._tell_libraries()  # finds what there is
    usual = pools("blas")
    with ThreadPoolExecutor(2) as executor, threads_of(executor):
        with threads_of(executor):
            pass
        assert pools("blas") == {1}
    assert pools("blas") == usual
