"""Features of some images in a file: how workers of a cluster get and return them.

COLMAP's database stays with one process. SQLite on a folder that several machines write to is how databases are
lost; and COLMAP's own merging of databases makes a camera of each part's, where one was shared.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap, translated
from colmap_ihe.errors import DiskFullError, NativeError
from colmap_ihe.machine.files import room_on_disk, write_bytes
from colmap_ihe.machine.scratch import scratch_folder

_Item = TypeVar("_Item")
_LITTLE = 1 << 20  # bytes free with which nothing can be written: a database grows in steps


@dataclass(frozen=True)
class Features:
    """Of one image, as the database has them. `keypoints`: (N, 6) float32; `descriptors`: (N, D) uint8; `kind`
    names pycolmap's type of extractor."""

    keypoints: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    kind: str


def read_features(database: pycolmap.Database, image_id: int) -> Features:
    found = database.read_descriptors(image_id)
    return Features(database.read_keypoints(image_id), found.data, found.type.name)


def write_features(database: pycolmap.Database, image_id: int, features: Features) -> None:
    """For an image that has none yet."""
    database.write_keypoints(image_id, features.keypoints)
    descriptors = pycolmap.FeatureDescriptors()
    descriptors.type = pycolmap.FeatureExtractorType.__members__[features.kind]
    descriptors.data = features.descriptors
    database.write_descriptors(image_id, descriptors)


def write_pack(path: Path, features: Mapping[int, Features]) -> None:
    """A file of the features of images by id, whole or not there."""
    arrays: dict[str, NDArray[Any]] = {}
    for image_id, found in features.items():
        arrays[f"{image_id}.keypoints"] = found.keypoints
        arrays[f"{image_id}.descriptors"] = found.descriptors
        arrays[f"{image_id}.kind"] = np.array(found.kind)
    content = BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    write_bytes(path, content.getvalue())


def read_pack(path: Path, image_ids: Iterable[int] | None = None) -> Iterator[tuple[int, Features]]:
    """Those of some images in a pack, or of all; what is not asked for is not read."""
    with np.load(path, allow_pickle=False) as pack:
        if image_ids is None:
            image_ids = [int(name.partition(".")[0]) for name in pack.files if name.endswith(".kind")]
        for image_id in image_ids:
            keypoints, descriptors = (pack[f"{image_id}.{what}"] for what in ("keypoints", "descriptors"))
            yield image_id, Features(keypoints, descriptors, str(pack[f"{image_id}.kind"]))


def merge_pack(database: Path, pack: Path) -> int:
    """Puts the features of a pack into the database, all or none; returns of how many images."""
    count = 0
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for image_id, features in read_pack(pack):
            if not opened.exists_keypoints(image_id):
                write_features(opened, image_id, features)
            count += 1
    return count


@contextmanager
def room_of_a_task() -> Iterator[Path]:
    """A folder on a disk of the worker's own, while a task lasts. Raises `DiskFullError` where that is full,
    whatever COLMAP makes of it, else `NativeError`."""
    with scratch_folder() as folder:
        try:
            with room_on_disk(folder):
                yield folder
        except (RuntimeError, NativeError) as error:
            if shutil.disk_usage(folder).free < _LITTLE:
                raise DiskFullError(
                    f"{folder}: no room left on this disk",
                    hint="make room there, or set TMPDIR where workers are started; the same command goes on from here",
                ) from error
            raise translated(error) from error


def in_batches(items: Sequence[_Item], size: int) -> Iterator[Sequence[_Item]]:
    """One part after the other, of `size` items, the last perhaps of fewer."""
    for begin in range(0, len(items), size):
        yield items[begin : begin + size]
