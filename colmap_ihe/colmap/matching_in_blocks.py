"""Match by processes and by the workers of a cluster: blocks of pairs, each in a database of its own images only."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Generator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.colmap import part_databases
from colmap_ihe.colmap.match_block import Block, match_block
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.pair_blocks import (
    are_few,
    batch_of,
    blocks_of,
    group_size,
    groups_of,
    matches_bytes,
    seconds_of,
    shared_out,
)
from colmap_ihe.colmap.part_databases import Pair, copy_features, copy_matches, ordered
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import TaskProgress, in_order, width_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.project.options import MatchesOptions

_PROCESS_SECONDS = 1.0  # of matching on one core: two processes take nearly as much to start
_GRACE_SECONDS = 60.0  # to keep what is matched already; COLMAP stops after the batch that it is at


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
    """Match as `match_in_blocks`, by processes here: as many as `threads`, 0 for one a core, if memory allows; what is
    done before a process would have started is matched here. What was matched is kept when it is stopped."""
    with pycolmap.Database.open(task.database) as opened:
        features, images = _most_features(opened), opened.num_images()
    advanced: Counter[Path] = Counter()
    missing = _missing(task)
    if seconds_of(missing, features) < _PROCESS_SECONDS:
        blocks = _blocks(task, missing, 1)
        here = (match_block(block, _BlockProgress(task.progress, block, advanced)) for block in blocks)
        return _collect(task, blocks, here, advanced)
    most = max(0, threads) or local_workers()
    count = memory.workers_for("matches", matches_bytes(features, images), most)
    with ColmapProcesses(most_threads=1) as processes, ThreadPoolExecutor(count) as executor:
        processes.start(min(count, len(missing)), match_block)
        blocks = _blocks(task, missing, count)

        def match(block: Block) -> Path:
            block_progress = _BlockProgress(task.progress, block, advanced)
            return processes.call(match_block, block, block_progress, _GRACE_SECONDS)

        return _collect(task, blocks, in_order(executor, match, blocks, 2 * count, task.progress), advanced)


def match_in_blocks(task: BlockMatching, executor: Executor) -> None:
    """Write verified matches by the workers of `executor`. Raises as `match_features`."""
    width = width_of(executor)
    blocks = _blocks(task, _missing(task), width)
    _collect(task, blocks, in_order(executor, match_block, blocks, 2 * width, task.progress), Counter())


def _missing(task: BlockMatching) -> list[Pair]:
    """Return the pairs that are not done, each the first way round that it is named, as COLMAP has it: the other gives
    other matches. Tell `progress` of the rest."""
    with pycolmap.Database.open(task.database) as opened:
        done = {pair for pair in task.pairs if opened.exists_two_view_geometry(*pair)}
    distinct = {ordered(pair): pair for pair in reversed(task.pairs)}
    missing = [pair for pair in reversed(distinct.values()) if pair not in done]
    task.progress.advance(len(task.pairs) - len(missing))
    return missing


def _blocks(task: BlockMatching, missing: Sequence[Pair], width: int) -> list[Block]:
    """Divide the pairs that are missing into blocks, and write the features of each group of images to `parts`."""
    task.parts.mkdir(parents=True)
    with pycolmap.Database.open(task.database) as opened:
        images = sorted(opened.read_all_images(), key=lambda image: str(image.name))
        by_id = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        features = _most_features(opened)
    cameras = {image.image_id: by_id[image.camera_id] for image in images}
    groups = groups_of(missing, list(cameras), group_size(len(missing), len(cameras), features, width))
    group_files: dict[int, Path] = {}
    for number, group in enumerate(groups):
        task.progress.check()
        file = task.parts / f"features-{number:06}.db"
        part_databases.write_images(file, {image_id: cameras[image_id] for image_id in group})
        copy_features(task.database, file)
        group_files |= dict.fromkeys(group, file)
    few = are_few(len(cameras), features)
    blocks = []
    for number, block_pairs in enumerate(shared_out(missing, width) if few else blocks_of(missing, groups)):
        ids = sorted({image_id for pair in block_pairs for image_id in pair})
        files = sorted({group_files[image_id] for image_id in ids})
        result = task.parts / f"matches-{number:06}.db"
        blocks.append(
            Block(
                pairs=tuple(block_pairs),
                cameras={image_id: cameras[image_id] for image_id in ids},
                features=tuple(files),
                matching=task.options.colmap,
                verification=task.options.verification,
                batch=batch_of(features),
                result=result,
            )
        )
    return blocks


def _collect(
    task: BlockMatching,
    blocks: Sequence[Block],
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

    def __init__(self, progress: Progress, block: Block, advanced: Counter[Path]) -> None:
        super().__init__()
        self._progress, self._block, self._advanced = progress, block, advanced

    def advance(self, count: int = 1) -> None:
        count = min(count, len(self._block.pairs) - self._advanced[self._block.result])
        self._advanced[self._block.result] += count
        self._progress.advance(count)
        self.check()


def _most_features(opened: pycolmap.Database) -> int:
    counts = (opened.num_keypoints_for_image(image.image_id) for image in opened.read_all_images())
    return max(counts, default=0)
