"""Features on the workers of a cluster: shards of images, each into a database of its own, then into one."""

from __future__ import annotations

import shutil
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.colmap.feature_files import in_batches, merge_pack, read_features, room_of_a_task, write_pack
from colmap_ihe.colmap.native import apply_options, called, hush, pycolmap
from colmap_ihe.machine.executor import TaskProgress, in_order, width_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import FeaturesOptions

_MOST = 16  # images a shard: what is lost with a worker
_SHARDS_A_WORKER = 4


@dataclass(frozen=True)
class _Shard:
    """`images`: id in the main database, and name below `grey`."""

    images: tuple[tuple[int, str], ...]
    grey: Path
    masks: Path | None
    options: FeaturesOptions
    pack: Path


def extract_in_shards(
    database: Path,
    grey: Path,
    masks: Path | None,
    options: FeaturesOptions,
    parts: Path,
    executor: Executor,
    progress: Progress,
) -> None:
    """Features of every image of the database that has none. `parts`: a folder for what is under way, which goes
    afterwards. Raises as `extract_features`."""
    with pycolmap.Database.open(database) as opened:
        images = [
            (image.image_id, image.name)
            for image in opened.read_all_images()
            if not opened.exists_keypoints(image.image_id)
        ]
        known = opened.num_images() - len(images)
    progress.advance(known)
    parts.mkdir(parents=True)
    size = max(1, min(_MOST, len(images) // (_SHARDS_A_WORKER * width_of(executor))))
    shards = [
        _Shard(tuple(some), grey, masks, options, parts / f"features-{number:06}.npz")
        for number, some in enumerate(in_batches(images, size))
    ]
    for pack in in_order(executor, extract_shard, shards, progress=progress):
        progress.advance(merge_pack(database, pack))
        pack.unlink()
    shutil.rmtree(parts)


def extract_shard(shard: _Shard) -> Path:
    """On a worker, with one thread, as it has several workers where it has several cores: writes the pack of a
    shard and returns its path. COLMAP leaves out images that it cannot read."""
    hush()
    extraction = extraction_options(shard.options, threads=1)
    reader = pycolmap.ImageReaderOptions()
    if shard.masks is not None:
        reader.mask_path = shard.masks
    ids = {name: image_id for image_id, name in shard.images}
    with room_of_a_task() as folder:
        database = folder / "shard.db"
        pycolmap.Database.open(database).close()
        called(
            pycolmap.extract_features,
            database,
            shard.grey,
            image_names=list(ids),
            camera_mode=pycolmap.CameraMode.PER_IMAGE,  # of no account: cameras are in the main database
            reader_options=reader,
            extraction_options=extraction,
            progress=TaskProgress(),
        )
        with pycolmap.Database.open(database) as opened:
            found = {
                ids[image.name]: read_features(opened, image.image_id)
                for image in opened.read_all_images()
                if opened.exists_keypoints(image.image_id)
            }
    write_pack(shard.pack, found)
    return shard.pack


def extraction_options(options: FeaturesOptions, threads: int = -1) -> pycolmap.FeatureExtractionOptions:
    """pycolmap's options for features; `threads` unless the user says how many. Raises `OptionError`."""
    extraction = pycolmap.FeatureExtractionOptions(num_threads=threads)
    if options.max_image_size is not None:
        extraction.max_image_size = options.max_image_size
    apply_options(extraction, options.colmap, "features.colmap")
    return extraction
