"""Extract images again at a lower peak threshold and with more scales, where features run out below COLMAP's cap.

With more scales an octave there are more features, and they lie more exactly. COLMAP caps their number by whole levels
of its scale space, coarse ones first, so that weak coarse features would push strong fine ones out. Here it is given no
cap, and an image gets the features of the lowest threshold at which those outside its mask are not too many: the cap
counts places at three scales an octave, so that it is larger by what five of them find more at the same threshold.
"""

from __future__ import annotations

import io
import shutil
import sqlite3
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.coarse_first import places
from colmap_ihe.colmap.database import writing
from colmap_ihe.colmap.extraction import extract_apart, extraction_options
from colmap_ihe.colmap.native import hush, pycolmap
from colmap_ihe.colmap.part_databases import task_folder
from colmap_ihe.machine.executor import TaskProgress, in_order, shares_memory
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import FeaturesOptions

COLMAPS_THRESHOLD = 0.02 / 3
LOWEST = 0.5
"""Of COLMAP's peak threshold, which is 1.7 of 255 grey levels: of less than one level it is rounding that is found."""
SCALES = 5
"""An octave, of features that are extracted again; COLMAP has 3."""
_FINER = (2 ** (1 / SCALES) - 1) / (2 ** (1 / 3) - 1)
"""How much less two neighbouring scales differ then, which the threshold is held against (Lowe 2004, 3)."""
_MORE = 1.4
"""Times as many places at the same threshold then, and the cap with it (benchmarks/thresholds.md)."""
UNIT = "images, lower threshold"
_STEPS = 32  # to which a threshold in between is rounded up, so that images share it
_NO_CAP = 1_000_000
_IMAGES = 16  # a shard: what is lost with a worker, or an interruption
_TABLE = "colmap_ihe_thresholds"

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class _Image:
    """Hold an image that stayed below the cap: its id in the main database, its places with features there, and whether
    it has a mask."""

    name: str
    image_id: int
    places: int
    masked: bool


@dataclass(frozen=True)
class _Shard:
    """Hold a task; `threads` of COLMAP, and the file to write to."""

    images: Sequence[_Image]
    grey: Path
    masks: Path | None
    options: FeaturesOptions
    threads: int
    result: Path


@dataclass(frozen=True)
class _Features:
    """Hold keypoints as COLMAP has them, (N, 4 or 6), their descriptors (N, 128), and the share of COLMAP's threshold
    at which they were found."""

    share: float
    keypoints: F32
    descriptors: U8


def lowers_thresholds(options: FeaturesOptions) -> bool:
    """Tell whether images are extracted again where features run out: not if the user gives a threshold. Raises
    `OptionError`."""
    extraction = extraction_options(options)
    given = "peak_threshold" in options.colmap.get("sift", {})
    return bool(extraction.type == pycolmap.FeatureExtractorType.SIFT) and not given


def lower(extraction: pycolmap.FeatureExtractionOptions, share: float = LOWEST, finer: bool = True) -> None:
    """Set a share of the threshold, and `SCALES` where it is to be finer."""
    extraction.sift.peak_threshold *= share
    if finer:
        extraction.sift.peak_threshold *= _FINER
        extraction.sift.octave_resolution = SCALES


def extract_again(
    database: Path,
    grey: Path,
    masks: Path | None,
    options: FeaturesOptions,
    threads: int,
    parts: Path,
    executor: Executor,
    progress: Progress,
) -> None:
    """Extract again the images of the database that stayed below the cap, on `threads` here, or on the workers of an
    executor of another kind, with the same result. `parts`: a folder for unfinished work, which is removed afterwards.

    An image's features are replaced in one step in which it is noted too, so an interruption leaves it with those of
    the first threshold, and the next run takes it up again. Raises as `extract_features`.
    """
    images = _below_the_cap(database, masks, extraction_options(options).sift.max_num_features)
    if not images:
        return
    progress.start(len(images), UNIT)
    parts.mkdir(parents=True, exist_ok=True)
    local = shares_memory(executor)
    shards = [
        _Shard(
            images[begin : begin + _IMAGES],
            grey,
            masks,
            options,
            threads if local else 1,
            parts / f"again-{begin:06}.npz",
        )
        for begin in range(0, len(images), _IMAGES)
    ]
    results: Iterable[_Shard] = (
        (_extract_shard(shard, progress) for shard in shards)
        if local
        else in_order(executor, extract_shard_again, shards, progress=progress)
    )
    for shard in results:
        _replace_features(database, shard)
        shard.result.unlink()
        progress.advance(len(shard.images))
    shutil.rmtree(parts)


def count_extracted_again(database: Path) -> int:
    """Return how many images have other features than at first."""
    return sum(share is not None for share in _noted(database).values())


def cap_again(options: FeaturesOptions) -> int:
    """Return how many places with features an image that is extracted again may have; the user's own number is kept
    to, as it may be a limit of memory. Raises `OptionError`."""
    own = {"octave_resolution", "max_num_features"} & set(options.colmap.get("sift", {}))
    return round((1 if own else _MORE) * extraction_options(options).sift.max_num_features)


def _below_the_cap(database: Path, masks: Path | None, cap: int) -> list[_Image]:
    """Return the images to be extracted again, by name."""
    noted = _noted(database)
    with pycolmap.Database.open(database) as opened:
        images = [
            _Image(
                str(image.name),
                image.image_id,
                places(opened.read_keypoints(image.image_id)),
                masks is not None and (masks / f"{image.name}.png").exists(),
            )
            for image in opened.read_all_images()
            if image.image_id not in noted and opened.exists_keypoints(image.image_id)
        ]
    return sorted((i for i in images if i.places < cap), key=lambda image: image.name)


def extract_shard_again(shard: _Shard) -> _Shard:
    """Write the features of a shard's images, as a task of a worker; return the shard."""
    hush()
    return _extract_shard(shard, TaskProgress())


def _extract_shard(shard: _Shard, progress: Progress) -> _Shard:
    finer = "octave_resolution" not in shard.options.colmap.get("sift", {})
    more = _MORE if finer else 1
    cap = cap_again(shard.options)
    lowest = _extracted(shard, shard.images, LOWEST, finer, progress)
    chosen = _fitting(lowest, cap)
    by_id = {image.image_id: image for image in shard.images}
    by_share = defaultdict(list)
    for image_id in lowest.keys() - chosen.keys():
        first = round(more * by_id[image_id].places)
        by_share[_share_for(cap, first, places(lowest[image_id].keypoints))].append(by_id[image_id])
    for share, some in sorted(by_share.items()):
        some.sort(key=lambda image: image.name)
        chosen |= _fitting(_extracted(shard, some, share, finer, progress), cap)
    # the cap may have bound by what is under the mask
    masked = [image for image in shard.images if image.masked and image.image_id not in chosen]
    chosen |= _fitting(_extracted(shard, masked, 1.0, finer, progress), cap)
    _write(shard.result, chosen)
    return shard


def _fitting(features: Mapping[int, _Features], cap: int) -> dict[int, _Features]:
    return {i: found for i, found in features.items() if places(found.keypoints) <= cap}


def _share_for(cap: int, places: int, most: int) -> float:
    """Return the share of COLMAP's threshold for which `cap` places are expected, from those at COLMAP's own and the
    `most` at the lowest: their number goes down evenly with the threshold (benchmarks/thresholds.md)."""
    share = LOWEST + (1 - LOWEST) * (most - cap) / max(1, most - places)
    return float(min(_STEPS - 1, np.ceil(share * _STEPS) + 1) / _STEPS)


def _extracted(
    shard: _Shard, images: Sequence[_Image], share: float, finer: bool, progress: Progress
) -> dict[int, _Features]:
    """Return the features of images at a share of COLMAP's threshold, without a cap, by id; `finer`: with `SCALES`."""
    if not images:
        return {}
    extraction = extraction_options(shard.options, threads=shard.threads)
    lower(extraction, share, finer)
    extraction.sift.max_num_features = _NO_CAP
    ids = {image.name: image.image_id for image in images}
    with task_folder() as folder:
        database = folder / "again.db"
        extract_apart(database, shard.grey, shard.masks, list(ids), extraction, progress)
        with pycolmap.Database.open(database) as opened:
            return {
                ids[str(image.name)]: _Features(
                    share,
                    np.array(opened.read_keypoints(image.image_id), np.float32),
                    np.array(opened.read_descriptors(image.image_id).data, np.uint8),
                )
                for image in opened.read_all_images()
                if opened.exists_keypoints(image.image_id)
            }


def _write(file: Path, features: Mapping[int, _Features]) -> None:
    arrays: dict[str, Any] = {"ids": np.array(sorted(features), np.int64)}
    for image_id, found in features.items():
        arrays[f"share {image_id}"] = np.array(found.share)
        arrays[f"keypoints {image_id}"] = found.keypoints
        arrays[f"descriptors {image_id}"] = found.descriptors
    content = io.BytesIO()
    np.savez(content, **arrays)
    write_bytes(file, content.getvalue())


def _read(file: Path) -> Iterator[tuple[int, _Features]]:
    with np.load(file, allow_pickle=False) as arrays:
        for image_id in arrays["ids"].tolist():
            keypoints, descriptors = arrays[f"keypoints {image_id}"], arrays[f"descriptors {image_id}"]
            yield image_id, _Features(float(arrays[f"share {image_id}"]), keypoints, descriptors)


def _replace_features(database: Path, shard: _Shard) -> None:
    """Replace the features of a shard's images and note the threshold of each, all or none. COLMAP leaves
    further tables alone. Raises `NativeError`."""
    shares: dict[int, float | None] = {image.image_id: None for image in shard.images}
    with writing(database) as opened:
        for image_id, found in _read(shard.result):
            shares[image_id] = found.share
            _write_over(opened, "keypoints", image_id, found.keypoints)
            _write_over(opened, "descriptors", image_id, found.descriptors)
        opened.execute(f"CREATE TABLE IF NOT EXISTS {_TABLE} (image_id INTEGER PRIMARY KEY, share REAL)")
        opened.executemany(f"INSERT OR REPLACE INTO {_TABLE} VALUES (?, ?)", sorted(shares.items()))


def _write_over(opened: sqlite3.Connection, table: str, image_id: int, values: F32 | U8) -> None:
    rows, columns = values.shape
    opened.execute(
        f"UPDATE {table} SET rows = ?, cols = ?, data = ? WHERE image_id = ?",
        (rows, columns, values.tobytes(), image_id),
    )


def _noted(database: Path) -> dict[int, float | None]:
    """Return the share of COLMAP's threshold of each image that was looked at, by id; None if it was left as it was."""
    with closing(sqlite3.connect(database)) as opened:
        known = opened.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (_TABLE,)).fetchone()
        return dict(opened.execute(f"SELECT image_id, share FROM {_TABLE}")) if known else {}
