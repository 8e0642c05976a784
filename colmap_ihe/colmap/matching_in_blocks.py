"""Match by processes and by the workers of a cluster: blocks of pairs, each in a database of its own images only."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from colmap_ihe.colmap import part_databases
from colmap_ihe.colmap.database import counting_rows
from colmap_ihe.colmap.native import apply_options, called, hush, pycolmap
from colmap_ihe.colmap.pair_blocks import batch_of, blocks_of, group_size, groups_of, matches_bytes
from colmap_ihe.colmap.part_databases import Pair, copy_features, copy_matches, ordered, task_folder
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.errors import Cancelled
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import TaskProgress, in_order, width_of
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.project.options import MatchesOptions

SEED = 0
"""Of RANSAC, for every pair anew: so a pair gives the same matches wherever, and beside whatever, it is verified."""
_GRACE_SECONDS = 60.0  # to keep what is matched already; COLMAP stops after the batch that it is at
_alone = Lock()  # for workers of several threads, which COLMAP's matcher is not safe on


@dataclass(frozen=True)
class _Block:
    """Hold pairs to match together. `cameras`: that of each image by its id; `features`: the databases with their
    features, those of other images too; `batch`: the number of pairs until it can be stopped."""

    pairs: tuple[Pair, ...]
    cameras: Mapping[int, pycolmap.Camera]
    features: tuple[Path, ...]
    options: MatchesOptions
    batch: int
    result: Path


@dataclass(frozen=True)
class BlockMatching:
    """Hold what is matched: those of `pairs` that have no geometry in the database yet. `parts`: a folder for
    unfinished work, which is removed afterwards."""

    database: Path
    pairs: Sequence[Pair]
    options: MatchesOptions
    parts: Path
    progress: Progress


def match_in_processes(task: BlockMatching, threads: int) -> None:
    """Match as `match_in_blocks`, by processes here: as many as `threads`, 0 for one a core, if memory allows. What
    was matched is kept when it is stopped."""
    with pycolmap.Database.open(task.database) as opened:
        needed = matches_bytes(_most_features(opened), opened.num_images())
    count = memory.workers_for("matches", needed, max(0, threads) or local_workers())
    advanced: Counter[Path] = Counter()
    blocks = _blocks(task, count)
    with ColmapProcesses(most_threads=1) as processes, ThreadPoolExecutor(count) as executor:

        def match(block: _Block) -> Path:
            block_progress = _BlockProgress(task.progress, block, advanced)
            return processes.call(match_block, block, block_progress, _GRACE_SECONDS)

        _collect(task, blocks, in_order(executor, match, blocks, 2 * count, task.progress), advanced)


def match_in_blocks(task: BlockMatching, executor: Executor) -> None:
    """Write verified matches by the workers of `executor`. Raises as `match_features`."""
    width = width_of(executor)
    blocks = _blocks(task, width)
    _collect(task, blocks, in_order(executor, match_block, blocks, 2 * width, task.progress), Counter())


def _blocks(task: BlockMatching, width: int) -> list[_Block]:
    """Divide the pairs that are not done into blocks, and write the features of each group of images to `parts`."""
    task.parts.mkdir(parents=True)
    with pycolmap.Database.open(task.database) as opened:
        done = {pair for pair in task.pairs if opened.exists_two_view_geometry(*pair)}
        images = sorted(opened.read_all_images(), key=lambda image: str(image.name))
        by_id = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        features = _most_features(opened)
    cameras = {image.image_id: by_id[image.camera_id] for image in images}
    # The first way round that a pair is named, as COLMAP has it: the other gives other matches.
    distinct = {ordered(pair): pair for pair in reversed(task.pairs)}
    missing = [pair for pair in reversed(distinct.values()) if pair not in done]
    task.progress.advance(len(task.pairs) - len(missing))
    groups = groups_of(missing, list(cameras), group_size(len(missing), len(cameras), features, width))
    group_files: dict[int, Path] = {}
    for number, group in enumerate(groups):
        task.progress.check()
        file = task.parts / f"features-{number:06}.db"
        part_databases.write_images(file, {image_id: cameras[image_id] for image_id in group})
        copy_features(task.database, file)
        group_files |= dict.fromkeys(group, file)
    blocks = []
    for number, block_pairs in enumerate(blocks_of(missing, groups)):
        ids = sorted({image_id for pair in block_pairs for image_id in pair})
        files = sorted({group_files[image_id] for image_id in ids})
        result = task.parts / f"matches-{number:06}.db"
        own_cameras, batch = {image_id: cameras[image_id] for image_id in ids}, batch_of(features)
        blocks.append(_Block(tuple(block_pairs), own_cameras, tuple(files), task.options, batch, result))
    return blocks


def _collect(
    task: BlockMatching,
    blocks: Sequence[_Block],
    results: Generator[Path, None, None],
    advanced: Counter[Path],
) -> None:
    """Copy the matches of each block into the database; `advanced`: the pairs of it that `progress` was told of."""
    try:
        with closing(results):
            for block, result in zip(blocks, results, strict=True):
                copy_matches(result, task.database, block.pairs)
                result.unlink()
                task.progress.advance(len(block.pairs) - advanced[result])
    finally:
        with suppress(RuntimeError):  # of a disk without room, perhaps, for which the others stopped
            for block in blocks:
                if block.result.exists():  # of one that was stopped
                    copy_matches(block.result, task.database, block.pairs)
        shutil.rmtree(task.parts, ignore_errors=True)


class _BlockProgress(TaskProgress):
    """Pass on the pairs of a block that are done, and count them in `advanced`."""

    def __init__(self, progress: Progress, block: _Block, advanced: Counter[Path]) -> None:
        super().__init__()
        self._progress, self._block, self._advanced = progress, block, advanced

    def advance(self, count: int = 1) -> None:
        count = min(count, len(self._block.pairs) - self._advanced[self._block.result])
        self._advanced[self._block.result] += count
        self._progress.advance(count)
        self.check()


def match_block(block: _Block, progress: Progress | None = None) -> Path:
    """Write a database with the matches of a block and their geometry, on one thread, and return its path. Where
    `progress` stops it, it writes what there is; a worker of a cluster has none, since nobody waits for its part."""
    hush()
    matching, verification = matching_options(block.options), verification_options(block.options)
    matching.num_threads = 1
    with task_folder() as folder:
        database, list_file = folder / "block.db", folder / "pairs.txt"
        part_databases.write_images(database, block.cameras)
        for file in block.features:
            copy = shutil.copyfile(file, folder / file.name)
            copy_features(copy, database)
            copy.unlink()
        pairing = pycolmap.ImportedPairingOptions(match_list_path=list_file, block_size=block.batch)
        list_file.write_text("".join(f"{a} {b}\n" for a, b in block.pairs), encoding="ascii")
        try:
            with _alone, counting_rows(database, "two_view_geometries") as rows:
                called(
                    pycolmap.match_image_pairs,
                    database,
                    matching_options=matching,
                    pairing_options=pairing,
                    verification_options=verification,
                    progress=progress or TaskProgress(),
                    units_done=rows,
                )
        except Cancelled:
            if progress is not None:
                _write_matches(database, folder, block)
            raise
        _write_matches(database, folder, block)
    return block.result


def _write_matches(database: Path, folder: Path, block: _Block) -> None:
    copy_matches(database, folder / "matches.db", block.pairs)
    write_bytes(block.result, (folder / "matches.db").read_bytes())


def matching_options(options: MatchesOptions) -> pycolmap.FeatureMatchingOptions:
    """Return pycolmap's options for matching. Raises `OptionError`."""
    return apply_options(pycolmap.FeatureMatchingOptions(), options.colmap, "matches.colmap")


def verification_options(options: MatchesOptions) -> pycolmap.TwoViewGeometryOptions:
    """Return pycolmap's options for verification. Raises `OptionError`."""
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    return apply_options(verification, options.verification, "matches.verification")


def _most_features(opened: pycolmap.Database) -> int:
    counts = (opened.num_keypoints_for_image(image.image_id) for image in opened.read_all_images())
    return max(counts, default=0)
