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

from colmap_ihe.colmap.match_blocks import _blocks
from colmap_ihe.colmap.matching import forget_matches, match_features
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.options import MatchesOptions
from colmap_ihe.progress import SILENT

PAIRINGS: dict[str, dict[str, Any]] = {
    "exhaustive": {},
    "sequential": {"overlap": 1, "quadratic_overlap": False},
    "spatial": {"max_num_neighbors": 2, "max_distance": 25.0},
    "vocabtree": {"num_images": 3},
}
PLACES = 8  # on a line, 10 m apart: neighbours, and no others, lie within 25 m with one between them


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
        return {
            pycolmap.pair_id_to_image_pair(i): (
                opened.read_matches(*pycolmap.pair_id_to_image_pair(i)).tobytes(),
                geometry.inlier_matches.tobytes(),
            )
            for i, geometry in zip(ids, geometries, strict=True)
        }


def assert_alike(found: Matched, wanted: Matched) -> None:
    """The same to the byte, but for the inliers of one pair at most: once in thousands of pairs COLMAP verifies a few
    other matches than before, from the same seed."""
    assert found.keys() == wanted.keys()
    assert all(found[pair][0] == wanted[pair][0] for pair in wanted)
    other = [pair for pair in wanted if found[pair] != wanted[pair]]
    assert len(other) <= 1
    for pair in other:
        assert len(found[pair][1]) == pytest.approx(len(wanted[pair][1]), rel=0.1)


@pytest.mark.parametrize(
    "strategy", [pytest.param(n, marks=pytest.mark.slow if n == "vocabtree" else ()) for n in PAIRINGS]
)
def test_as_colmap_does(database: Path, tmp_path: Path, executor: Executor, strategy: str) -> None:
    options = MatchesOptions.model_validate({"strategy": strategy, "pairing": PAIRINGS[strategy]})
    other = Path(shutil.copy(database, tmp_path / "other.db"))
    with ThreadPoolExecutor(1) as here:
        counts = match_features(other, tmp_path, options, 8, 8, here, SILENT)
    found = match_features(database, tmp_path, options, 8, 8, executor, SILENT)
    pairs = set(matched(database))
    if strategy == "vocabtree":  # of COLMAP's threads, which decide what of a pair comes first
        assert pairs == set(matched(other))
        assert abs(found.inliers - counts.inliers) < 0.02 * counts.inliers
    else:
        assert (found.pairs_matched, found.pairs_verified) == (counts.pairs_matched, counts.pairs_verified)
        assert_alike(matched(database), matched(other))
    if strategy == "exhaustive":
        assert len(pairs) == 28
    elif strategy == "sequential":
        assert pairs == {(i, i + 1) for i in range(1, PLACES)}
    elif strategy == "spatial":
        assert {(i, i + 1) for i in range(1, PLACES)} <= pairs
        assert all(other - one <= 2 for one, other in pairs)
    else:
        assert 7 <= len(pairs) < 28


def test_goes_on_where_it_was_interrupted(database: Path, tmp_path: Path, executor: Executor) -> None:
    match_features(database, tmp_path, MatchesOptions(), 8, 0, executor, SILENT)
    before = matched(database)
    with pycolmap.Database.open(database) as opened:
        for pair in list(before)[::3]:
            opened.delete_matches(*pair)
            opened.delete_two_view_geometry(*pair)
    match_features(database, tmp_path, MatchesOptions(), 8, 0, executor, SILENT)
    assert_alike(matched(database), before)


@pytest.mark.parametrize(("images", "size"), [(8, 2), (50, 16), (3, 16)])
def test_every_pair_is_in_one_block(images: int, size: int) -> None:
    ids = list(range(1, images + 1))
    pairs = [(i, j) for i in ids for j in ids if i < j]
    blocks = list(_blocks(pairs, ids, size))
    assert sorted(pair for block in blocks for pair in block) == pairs
    assert max(map(len, blocks)) <= 2 * size * size
    sparse = [(i, i + 1) for i in ids[:-1]]
    assert sorted(pair for block in _blocks(sparse, ids, size) for pair in block) == sparse
