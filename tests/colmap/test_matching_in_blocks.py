"""Pairs matched in blocks by workers: those, and as, COLMAP matches them itself, by every strategy."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import StopsWhen

from colmap_ihe.colmap import match_block, matching
from colmap_ihe.colmap import matching_in_blocks as match_blocks
from colmap_ihe.colmap.matching import build_vocabulary, forget_matches, match_features, native_options
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.options import MatchesOptions

PAIRINGS: dict[str, dict[str, Any]] = {
    "exhaustive": {},
    "sequential": {"overlap": 1, "quadratic_overlap": False},
    "spatial": {"max_num_neighbors": 2, "max_distance": 25.0},
    "vocabtree": {"num_images": 3},
}
PLACES = 8  # on a line, 10 m apart: neighbours, and no others, lie within 25 m with one between them


SLOW = MatchesOptions(verification={"ransac": {"min_num_trials": 6000, "max_num_trials": 6000}})


class Pickling(Executor):
    """Threads that get and return copies, as processes do."""

    width = 2

    def __init__(self) -> None:
        self.threads = ThreadPoolExecutor(2)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        packed = pickle.dumps((fn, args, kwargs))

        def work() -> Any:
            function, given, named = pickle.loads(packed)
            return pickle.loads(pickle.dumps(function(*given, **named)))

        return self.threads.submit(work)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self.threads.shutdown(wait, cancel_futures=cancel_futures)


@pytest.fixture
def executor() -> Iterator[Executor]:
    with Pickling() as workers:
        yield workers


@pytest.fixture
def database(finished: Path) -> Path:
    """Features, and places by GPS."""
    file = finished / "workspace/database.db"
    forget_matches(file)
    with pycolmap.Database.open(file) as opened:
        for prior in opened.read_all_pose_priors():
            east = 10.0 * prior.corr_data_id.id / 111_320  # degrees, at the equator
            prior.position = np.array([0.0, east, 0.0])
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.WGS84
            opened.update_pose_prior(prior)
    return file


Matched = dict[tuple[int, int], tuple[bytes, bytes]]


def matched(database: Path) -> Matched:
    """By pair its putative matches and its inliers."""
    with pycolmap.Database.open(database) as opened:
        ids, geometries = opened.read_two_view_geometries()
        pairs = map(pycolmap.pair_id_to_image_pair, ids)
        return {
            pair: (opened.read_matches(*pair).tobytes(), geometry.inlier_matches.tobytes())
            for pair, geometry in zip(pairs, geometries, strict=True)
        }


@pytest.fixture(params=["here", "processes", "workers"])
def anyone(
    request: pytest.FixtureRequest, executor: Executor, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Executor]:
    """This process for little work, threads, for which processes of ours match, and workers that are somewhere else."""
    if request.param == "workers":
        yield executor
        return
    if request.param == "processes":
        monkeypatch.setattr(match_blocks, "_PROCESS_SECONDS", 0)
    else:
        monkeypatch.setattr(match_blocks, "ColmapProcesses", None)
    with ThreadPoolExecutor(2) as here:
        yield here


@pytest.mark.parametrize(
    "strategy", [pytest.param(n, marks=pytest.mark.slow if n == "vocabtree" else ()) for n in PAIRINGS]
)
def test_as_colmap_does_with_one_thread(
    database: Path, tmp_path: Path, anyone: Executor, strategy: str
) -> None:
    options = MatchesOptions.model_validate({"strategy": strategy, "pairing": PAIRINGS[strategy]})
    other = Path(shutil.copy(database, tmp_path / "other.db"))
    found = match_features(database, tmp_path, options, 8, anyone, SILENT)
    pairs = set(matched(database))
    alone, pairing, verification = native_options(options, strategy)
    alone.num_threads = 1
    if strategy == "vocabtree":
        build_vocabulary(other, tmp_path / "tree.bin", SILENT)
        pairing.vocab_tree_path, pairing.num_threads = tmp_path / "tree.bin", 1
    getattr(pycolmap, f"match_{strategy}")(
        other, matching_options=alone, pairing_options=pairing, verification_options=verification
    )
    alike = matched(other)
    assert found.pairs_matched == len(pairs) == len(alike)
    if strategy == "vocabtree":  # COLMAP's own takes what of a pair comes first
        assert pairs == set(alike)
        inliers = sum(len(inliers) for _, inliers in alike.values()) // 8
        assert abs(found.inliers - inliers) < 0.02 * inliers
        assert 7 <= len(pairs) < 28
        return
    assert matched(database) == alike
    if strategy == "exhaustive":
        assert len(pairs) == 28
    elif strategy == "sequential":
        assert pairs == {(i, i + 1) for i in range(1, PLACES)}
    else:
        assert {(i, i + 1) for i in range(1, PLACES)} <= pairs
        assert all(other - one <= 2 for one, other in pairs)


def test_goes_on_where_it_was_interrupted(database: Path, tmp_path: Path, anyone: Executor) -> None:
    match_features(database, tmp_path, MatchesOptions(), 8, anyone, SILENT)
    before = matched(database)
    with pycolmap.Database.open(database) as opened:
        for pair in list(before)[::3]:
            opened.delete_matches(*pair)
            opened.delete_two_view_geometry(*pair)
    match_features(database, tmp_path, MatchesOptions(), 8, anyone, SILENT)
    assert matched(database) == before


def test_a_pair_without_a_match_is_done_too(
    database: Path, tmp_path: Path, executor: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pycolmap.Database.open(database) as opened:
        opened.clear_descriptors()
        for image in opened.read_all_images():
            noise = pycolmap.FeatureDescriptors()
            noise.type = pycolmap.FeatureExtractorType.SIFT
            count = opened.num_keypoints_for_image(image.image_id)
            noise.data = np.random.default_rng(image.image_id % 7).integers(0, 60, (count, 128), np.uint8)
            opened.write_descriptors(image.image_id, noise)
    found = match_features(database, tmp_path, MatchesOptions(), 8, executor, SILENT)
    assert (found.pairs_matched, len(matched(database))) == (28, 1)  # images 1 and 8 have the same noise
    monkeypatch.setattr(match_blocks, "match_block", None)  # nothing is matched again
    assert match_features(database, tmp_path, MatchesOptions(), 8, executor, SILENT) == found


@pytest.mark.parametrize("in_processes", [True, False])
def test_what_was_matched_is_kept_when_it_is_stopped(
    database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_processes: bool
) -> None:
    if in_processes:
        monkeypatch.setattr(match_blocks, "_PROCESS_SECONDS", 0)
        monkeypatch.setattr(
            match_block, "_write_matches", None
        )  # it is in the processes that it has to happen
    monkeypatch.setattr(match_blocks, "batch_of", lambda _features: 1)
    with ThreadPoolExecutor(2) as here:
        with pytest.raises(Cancelled):
            match_features(database, tmp_path, SLOW, 8, here, StopsWhen(lambda done: done >= 1))
        kept = matched(database)
        assert 0 < len(kept) < 28
        assert not (tmp_path / "parts").exists()
        progress = StopsWhen(lambda done: done >= 29)
        match_features(database, tmp_path, MatchesOptions(), 8, here, progress)
    assert (progress.done, progress.total) == (28, 28)
    assert kept.items() <= matched(database).items()


def test_on_a_gpu_colmap_has_its_threads(
    database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matching, "cuda_devices", lambda: 1)
    monkeypatch.setattr(matching, "match_in_processes", None)
    options = MatchesOptions(colmap={"use_gpu": True, "num_threads": 1})  # which it has not here
    with ThreadPoolExecutor(2) as here:
        assert match_features(database, tmp_path, options, 8, here, SILENT).pairs_matched == 28
