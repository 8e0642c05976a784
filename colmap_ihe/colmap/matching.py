"""Choose the pairs of images to match, and write their verified matches into the database."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.colmap.database import counting_rows
from colmap_ihe.colmap.gps_fixes import forget_impossible_fixes, useful_fixes
from colmap_ihe.colmap.match_block import matching_options, verification_options
from colmap_ihe.colmap.matching_in_blocks import BlockMatching, match_in_blocks, match_in_processes
from colmap_ihe.colmap.native import apply_options, called, cuda_devices, pycolmap
from colmap_ihe.colmap.part_databases import Pair
from colmap_ihe.errors import MappingError, ProjectError
from colmap_ihe.machine.executor import shares_memory
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import MatchesOptions

EXHAUSTIVE_UP_TO = 200
"""Photographs: 19,900 pairs, about an hour on two cores; past it time grows with the square."""
VOCABULARY = "vocabulary.bin"
_VOCABULARY_FEATURES = 200_000
_VOCABULARY_IMAGES = 2000  # of which there are features in a vocabulary, spread over the set
_CHOSEN = "chosen.txt"
_GPS_SHARE = 0.9
_WORDS_PER_FEATURE = 1 / 40  # its clustering wants 39 features a word
# Of clustering: COLMAP's 100 and 3 find no more of the pairs that match (benchmarks/vocabulary.md).
_ROUNDS = (5, 1)


_CLASSES = {name.lower(): f"{name}Pair" for name in ("Exhaustive", "Sequential", "Spatial", "VocabTree")}
"""Of a strategy, what the names of its classes in pycolmap begin with: those of its options, and of its pairs."""


@dataclass(frozen=True)
class MatchCounts:
    """Count the pairs of a set. `found_again`: the share of an image's features with a verified match in the image most
    like it, in the median over the images that match any. `without_fix`: names of the grey images that spatial matching
    could say nothing of, and that were compared with others all the same."""

    strategy: str
    pairs_matched: int
    pairs_verified: int
    inliers: int
    found_again: float
    without_fix: tuple[str, ...] = ()


def choose_strategy(requested: str, images: int, with_gps: int) -> str:
    """Return the strategy for `auto`; another is used as requested. `with_gps`: images whose fix tells them apart.
    Raises `ProjectError` for spatial without any."""
    if requested == "spatial" and not with_gps:
        raise ProjectError(
            "matches.strategy is spatial, and no photograph has GPS latitude, longitude and altitude of its own",
            hint="use exhaustive or vocabtree",
        )
    if requested != "auto":
        return requested
    if images <= EXHAUSTIVE_UP_TO:
        return "exhaustive"
    return "spatial" if with_gps >= _GPS_SHARE * images else "vocabtree"


def pairs_of(strategy: str, images: int) -> int:
    """Return about how many pairs a strategy looks at."""
    if strategy == "exhaustive":
        return math.comb(images, 2)
    if strategy == "sequential":
        return images * 2 * pycolmap.SequentialPairingOptions().overlap
    if strategy == "spatial":
        return images * pycolmap.SpatialPairingOptions().max_num_neighbors // 2
    return math.comb(min(images, pycolmap.VocabTreePairingOptions().num_images), 2)


def match_features(
    database: Path,
    scratch: Path,
    options: MatchesOptions,
    images: int,
    executor: Executor,
    progress: Progress,
) -> MatchCounts:
    """Match and verify pairs; pairs that are in the database already are left alone.

    COLMAP does it in processes of one thread, ours or the workers of a cluster, with the same result: its matcher is
    not safe on several threads (docs/decisions/0014). On a GPU, where it is another, COLMAP has its threads. A
    vocabulary tree is built from the set's own features, in `scratch`: nothing is downloaded. Images without a
    partner by GPS are compared with all, in large sets with those that look like them. Raises `OptionError`,
    `NativeError`, `MappingError` if nothing matches, `ProjectError` for spatial without GPS, `Cancelled`.
    """
    forget_impossible_fixes(database)
    strategy = choose_strategy(options.strategy, images, len(useful_fixes(database)))
    matching, pairing, verification = native_options(options, strategy)
    shutil.rmtree(parts := scratch / "parts", ignore_errors=True)  # of a run that was interrupted
    on_gpu = bool(matching.use_gpu and cuda_devices() and shares_memory(executor))
    if hasattr(pairing, "num_threads") and not on_gpu:
        pairing.num_threads = 1
    needs_tree = strategy == "vocabtree" or options.pairing.get("loop_detection")
    if needs_tree and "vocab_tree_path" not in options.pairing:
        pairing.vocab_tree_path = _vocabulary(database, scratch, progress)
    runs = [(strategy, pairing)]
    without_fix: list[str] = []
    if strategy == "spatial":
        without_fix = called(_without_partner, database, pairing, progress=progress, cancellable=False)
    if without_fix and images <= EXHAUSTIVE_UP_TO:
        runs.append(("exhaustive", pycolmap.ExhaustivePairingOptions()))
    elif without_fix:
        runs.append(("vocabtree", _look_alikes(database, scratch, without_fix, progress)))
    if on_gpu:
        settings: dict[str, Any] = {"matching_options": matching, "verification_options": verification}
        for name, own in runs:
            expected = min(pairs_of(name, images), math.comb(images, 2))
            _match_on_gpu(database, name, {"pairing_options": own, **settings}, expected, progress)
    else:
        pairs: list[Pair] = []
        for name, own in runs:
            found = called(_pairs, database, name, own, progress=progress, cancellable=False)
            pairs += found if name == strategy else _pairs_with(database, without_fix, found)
        progress.start(len(pairs), "pairs")
        task = BlockMatching(database, pairs, options, parts, progress)
        if shares_memory(executor):
            match_in_processes(task, matching.num_threads)
        else:
            match_in_blocks(task, executor)
    (scratch / VOCABULARY).unlink(missing_ok=True)
    (scratch / _CHOSEN).unlink(missing_ok=True)
    counts = _counts(database, strategy, without_fix)
    if not counts.pairs_verified:
        raise MappingError(f"no two of the {images} photographs match")
    return counts


def _match_on_gpu(
    database: Path, strategy: str, settings: Mapping[str, Any], expected: int, progress: Progress
) -> None:
    """Have COLMAP choose and match about `expected` pairs, on threads of its own."""
    progress.start(expected, "pairs")
    with counting_rows(database, "two_view_geometries") as rows:
        match = getattr(pycolmap, f"match_{strategy}")
        called(match, database, progress=progress, units_done=lambda: min(expected, rows()), **settings)


def _without_partner(database: Path, pairing: pycolmap.SpatialPairingOptions) -> list[str]:
    """Return the names of the images of which spatial matching says nothing: without a fix of their own, or with no
    other within reach of it."""
    paired = {image_id for pair in _pairs(database, "spatial", pairing) for image_id in pair}
    told = paired & set(useful_fixes(database, pairing.max_num_neighbors))
    with pycolmap.Database.open(database) as opened:
        images = {int(image.image_id): str(image.name) for image in opened.read_all_images()}
    return [name for image_id, name in images.items() if image_id not in told]


def _pairs_with(database: Path, names: Sequence[str], pairs: Sequence[Pair]) -> list[Pair]:
    """Return the pairs that hold an image of one of these names."""
    with pycolmap.Database.open(database) as opened:
        chosen = {int(image.image_id) for image in opened.read_all_images() if image.name in set(names)}
    return [pair for pair in pairs if chosen & set(pair)]


def _look_alikes(
    database: Path, scratch: Path, names: Sequence[str], progress: Progress
) -> pycolmap.VocabTreePairingOptions:
    """Return options that pair the images of these names with those of the set that look most like them."""
    options = apply_options(pycolmap.VocabTreePairingOptions(), {}, "the vocabulary")
    options.vocab_tree_path = _vocabulary(database, scratch, progress)
    options.num_threads = 1
    if not any(name != name.strip() or name.startswith("#") for name in names):  # else all are asked for
        options.match_list_path = scratch / _CHOSEN
        write_bytes(options.match_list_path, "".join(f"{name}\n" for name in names).encode())
    return options


def _vocabulary(database: Path, scratch: Path, progress: Progress) -> Path:
    """Return the path of a vocabulary tree of the set."""
    build_vocabulary(database, scratch / VOCABULARY, progress)
    return scratch / VOCABULARY


def _counts(database: Path, strategy: str, without_fix: Sequence[str]) -> MatchCounts:
    with pycolmap.Database.open(database) as opened:
        # COLMAP keeps a row for a pair without an inlier too, and counts it as verified.
        inliers = np.array(opened.read_two_view_geometry_num_inliers()[1], np.int64)
        verified, again = int(np.count_nonzero(inliers)), found_again(opened)
        matched = opened.num_matched_image_pairs()
        return MatchCounts(strategy, matched, verified, int(inliers.sum()), again, tuple(without_fix))


def found_again(opened: pycolmap.Database) -> float:
    """Return `found_again` of `MatchCounts`, 0 where nothing matches."""
    best: dict[int, int] = {}
    for pair, count in zip(*opened.read_two_view_geometry_num_inliers(), strict=True):
        for image_id in pycolmap.pair_id_to_image_pair(pair) if count else ():
            best[image_id] = max(best.get(image_id, 0), int(count))
    shares = [count / opened.num_keypoints_for_image(image_id) for image_id, count in best.items()]
    return round(float(np.median(shares)), 3) if shares else 0.0


def native_options(
    options: MatchesOptions, strategy: str
) -> tuple[pycolmap.FeatureMatchingOptions, Any, pycolmap.TwoViewGeometryOptions]:
    """Return pycolmap's options for matching, pairing by `strategy` and verification. Raises `OptionError`."""
    pairing = getattr(pycolmap, f"{_CLASSES[strategy]}ingOptions")()
    apply_options(pairing, options.pairing, "matches.pairing")
    return matching_options(options.colmap), pairing, verification_options(options.verification)


def forget_matches(database: Path) -> None:
    """Remove all matches, as before matching; features stay."""
    with pycolmap.Database.open(database) as opened:
        opened.clear_matches()
        opened.clear_two_view_geometries()


def build_vocabulary(database: Path, tree: Path, progress: Progress) -> None:
    """Write a vocabulary tree of the set's own descriptors, an even share of each image's strongest."""
    with pycolmap.Database.open(database) as opened:
        ids = [image.image_id for image in opened.read_all_images()]
        sample = ids[:: -(-len(ids) // _VOCABULARY_IMAGES)]
        share = max(1, _VOCABULARY_FEATURES // len(sample))
        # copied, for a part of an array keeps all of it in memory
        data = np.concatenate([opened.read_descriptors(i).data[:share].astype(np.float32) for i in sample])
    build = apply_options(pycolmap.VisualIndex.BuildOptions(), {}, "the vocabulary")
    build.num_iterations, build.num_rounds = _ROUNDS
    build.num_visual_words = int(np.clip(len(data) * _WORDS_PER_FEATURE, 64, 65536))
    descriptors = pycolmap.FeatureDescriptorsFloat()
    descriptors.type = pycolmap.FeatureExtractorType.SIFT
    descriptors.data = data
    index = pycolmap.VisualIndex.create(data.shape[1], 64)
    called(index.build, build, descriptors, progress=progress, cancellable=False)
    tree.parent.mkdir(parents=True, exist_ok=True)
    index.write(tree)


def _pairs(database: Path, strategy: str, pairing: Any) -> list[tuple[int, int]]:
    """Return the pairs that COLMAP would match, by id."""
    with pycolmap.Database.open(database) as opened:
        generator = getattr(pycolmap, f"{_CLASSES[strategy]}Generator")(pairing, opened)
        pairs: list[tuple[int, int]] = generator.all_pairs()
    if strategy == "vocabtree":
        return sorted({(min(pair), max(pair)) for pair in pairs if pair[0] != pair[1]})
    return pairs
