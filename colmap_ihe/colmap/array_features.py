"""Extract COLMAP's features of pictures in memory.

By way of a temporary folder and database all the same: pycolmap's own functions for arrays hold Python's lock, so that
two of them never run at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.coarse_first import coarse_names, extract_coarse_first
from colmap_ihe.colmap.extraction import extraction_bytes
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.part_databases import task_folder
from colmap_ihe.machine.memory import workers_for
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]


def extract_arrays(
    images: Sequence[U8],
    options: pycolmap.FeatureExtractionOptions,
    task: str,
    progress: Progress = SILENT,
    *,
    octaves: str = "colmap",
) -> list[tuple[F32, U8]]:
    """Return keypoints as COLMAP has them, (N, 4 or 6) float32, and descriptors (N, 128) uint8 of each image, (H, W)
    uint8, on as many threads as memory has room for. `task` names the work where that is told, `octaves` is that of
    `FeaturesOptions`.

    The same images give the same features. Raises `NativeError`, `DiskFullError`, `Cancelled`, ValueError.
    """
    for grey in images:
        if grey.ndim != 2 or grey.dtype != np.uint8 or not grey.size:
            raise ValueError(f"{grey.shape=} {grey.dtype=}, expected (H, W) uint8")
    if not images:
        return []
    needed = extraction_bytes([(grey.shape[1], grey.shape[0]) for grey in images], options, 1)
    options.num_threads = min(workers_for(task, needed, local_workers()), len(images))
    names = [f"{number:06}.pgm" for number in range(len(images))]
    with task_folder() as folder:
        for name, grey in zip(names, images, strict=True):
            header = f"P5\n{grey.shape[1]} {grey.shape[0]}\n255\n".encode()
            (folder / name).write_bytes(header + grey.tobytes())
        sizes = {name: (g.shape[1], g.shape[0]) for name, g in zip(names, images, strict=True)}
        coarse = coarse_names(sizes, options) if octaves == "auto" else []
        database = folder / "features.db"
        extract_coarse_first(database, folder, names, coarse, options, progress)
        with pycolmap.Database.open(database) as opened:
            ids = {image.name: image.image_id for image in opened.read_all_images()}
            return [
                (
                    np.array(opened.read_keypoints(ids[name]), np.float32),
                    np.array(opened.read_descriptors(ids[name]).data, np.uint8).reshape(-1, 128),
                )
                for name in names
            ]
