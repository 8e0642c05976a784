"""Match a block of pairs, in a process of ours or on a worker of a cluster.

Each process imports this module first, so it imports little: no options of the project's.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from colmap_ihe.colmap import part_databases
from colmap_ihe.colmap.database import counting_rows
from colmap_ihe.colmap.native import apply_options, called, hush, pycolmap
from colmap_ihe.colmap.part_databases import Pair, copy_features, copy_matches, task_folder
from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.executor import TaskProgress
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress

SEED = 0
"""Of RANSAC, for every pair anew: so a pair gives the same matches wherever, and beside whatever, it is verified."""
_alone = Lock()  # for workers of several threads, which COLMAP's matcher is not safe on


@dataclass(frozen=True)
class Block:
    """Hold pairs to match together. `cameras`: that of each image by its id; `features`: the databases with their
    features, those of other images too; `matching`, `verification`: COLMAP's options by name; `batch`: the number of
    pairs until it can be stopped."""

    pairs: tuple[Pair, ...]
    cameras: Mapping[int, pycolmap.Camera]
    features: tuple[Path, ...]
    matching: Mapping[str, Any]
    verification: Mapping[str, Any]
    batch: int
    result: Path


def match_block(block: Block, progress: Progress | None = None) -> Path:
    """Write a database with the matches of a block and their geometry, on one thread, and return its path. Where
    `progress` stops it, it writes what there is; a worker of a cluster has none, since nobody waits for its part."""
    hush()
    matching, verification = matching_options(block.matching), verification_options(block.verification)
    matching.num_threads = 1
    with task_folder() as folder:
        database, list_file = folder / "block.db", folder / "pairs.txt"
        part_databases.write_images(database, block.cameras)
        for file in block.features:
            copy = shutil.copyfile(file, folder / file.name)
            copy_features(copy, database)
            copy.unlink()
        pairing = pycolmap.ImportedPairingOptions(match_list_path=list_file, block_size=block.batch)
        list_file.write_text("".join(f"{a} {b}\n" for a, b in block.pairs), encoding="ascii", newline="\n")
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


def _write_matches(database: Path, folder: Path, block: Block) -> None:
    copy_matches(database, folder / "matches.db", block.pairs)
    write_bytes(block.result, (folder / "matches.db").read_bytes())


def matching_options(options: Mapping[str, Any]) -> pycolmap.FeatureMatchingOptions:
    """Return pycolmap's options for matching. Raises `OptionError`."""
    return apply_options(pycolmap.FeatureMatchingOptions(), options, "matches.colmap")


def verification_options(options: Mapping[str, Any]) -> pycolmap.TwoViewGeometryOptions:
    """Return pycolmap's options for verification. Raises `OptionError`."""
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    return apply_options(verification, options, "matches.verification")
