"""Extract features on the workers of a cluster: shards of images, each into a database of its own, then into one."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.colmap.extraction import extract_apart, extraction_options
from colmap_ihe.colmap.native import hush, pycolmap
from colmap_ihe.colmap.part_databases import copy_features, task_folder
from colmap_ihe.machine.executor import TaskProgress, in_order, width_of
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import FeaturesOptions

_MOST = 16  # images a shard: what is lost with a worker
_SHARDS_A_WORKER = 4


@dataclass(frozen=True)
class _Shard:
    """Hold a task: `ids` in the main database by name below `grey`, those extracted coarse first, and the database to
    write to."""

    ids: dict[str, int]
    grey: Path
    masks: Path | None
    options: FeaturesOptions
    coarse: Sequence[str]
    result: Path


def extract_in_shards(
    database: Path,
    grey: Path,
    masks: Path | None,
    options: FeaturesOptions,
    coarse: Collection[str],
    parts: Path,
    executor: Executor,
    progress: Progress,
) -> None:
    """Extract features of every image of the database that has none, of the images `coarse` coarse first. `parts`: a
    folder for unfinished work, which is removed afterwards. Raises as `extract_features`."""
    with pycolmap.Database.open(database) as opened:
        images = [i for i in opened.read_all_images() if not opened.exists_keypoints(i.image_id)]
        progress.advance(opened.num_images() - len(images))
    parts.mkdir(parents=True)
    size = max(1, min(_MOST, len(images) // (_SHARDS_A_WORKER * width_of(executor))))
    shards = []
    for begin in range(0, len(images), size):
        ids = {str(image.name): image.image_id for image in images[begin : begin + size]}
        first = [name for name in ids if name in coarse]
        shards.append(_Shard(ids, grey, masks, options, first, parts / f"features-{begin:06}.db"))
    results = in_order(executor, extract_shard, shards, progress=progress)
    for shard, by_own_id in zip(shards, results, strict=True):
        copy_features(shard.result, database, by_own_id)
        shard.result.unlink()
        progress.advance(len(shard.ids))
    shutil.rmtree(parts)


def extract_shard(shard: _Shard) -> dict[int, int]:
    """Write the database of a shard, with one thread, as there are several workers where there are several cores.
    Return the ids of its images in the main database by its own. COLMAP leaves out images that it cannot read."""
    hush()
    extraction = extraction_options(shard.options, threads=1)
    with task_folder() as folder:
        database = folder / "shard.db"
        names, progress = list(shard.ids), TaskProgress()
        extract_apart(database, shard.grey, shard.masks, names, extraction, progress, shard.coarse)
        with pycolmap.Database.open(database) as opened:
            ids = {image.image_id: shard.ids[image.name] for image in opened.read_all_images()}
        content = database.read_bytes()
    write_bytes(shard.result, content)
    return ids
