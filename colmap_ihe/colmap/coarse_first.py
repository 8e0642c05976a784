"""Extract features without the finest octave, where COLMAP's cap would leave none of it.

COLMAP finds and describes features of all sizes, from twice the resolution of the image on, and only then keeps the
coarsest, whole levels of its scale space, until there are `max_num_features`. Of a large image these come from its own
resolution on, and what was found on the doubled image, in three quarters of the time, is thrown away.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.database import writing
from colmap_ihe.colmap.native import called, cuda_devices, pycolmap
from colmap_ihe.colmap.own_resolution import write_as_doubled
from colmap_ihe.colmap.part_databases import task_folder
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers

PIXELS_A_PLACE = 350
"""Of an image for each place of a feature in its own resolution: 380 to 550 in photographs of facades
(benchmarks/coarse_first.md). An image with fewer pixels than this for each place of the cap is not tried."""
_THRESHOLD, _CAP = 0.97, 1.03
"""Shares of COLMAP's peak threshold and of its cap, of images without the doubled one, so that they have no features
fewer for the rounding, and a few more do not cost a whole level of them (benchmarks/coarse_first.md)."""
_AT_ONCE = 8  # images at most for each thread, of which copies lie on the disk
_FINEST_SIZE = 1.59  # pixels of a feature: those of the image's own resolution are of 1.6 and more


def is_large(pixels: float, extraction: pycolmap.FeatureExtractionOptions) -> bool:
    """Tell whether an image of so many pixels, as COLMAP looks at it, is large for the cap."""
    return bool(pixels >= PIXELS_A_PLACE * extraction.sift.max_num_features)


def may_start_coarse(extraction: pycolmap.FeatureExtractionOptions) -> bool:
    """Tell whether large images may be extracted coarse first: SIFT on the CPU whose octaves begin where COLMAP's do,
    at its peak threshold, and whose images may be large for the cap."""
    sift = extraction.sift
    return bool(
        extraction.type == pycolmap.FeatureExtractorType.SIFT
        and sift.first_octave == -1
        and sift.num_octaves > 1
        and sift.peak_threshold == pycolmap.SiftExtractionOptions().peak_threshold
        and not (sift.estimate_affine_shape or sift.domain_size_pooling)
        and not (extraction.use_gpu and cuda_devices())
        and is_large(extraction.eff_max_image_size() ** 2, extraction)
    )


def coarse_names(
    sizes: Mapping[str, tuple[int, int]],
    extraction: pycolmap.FeatureExtractionOptions,
    masks: Path | None = None,
) -> list[str]:
    """Return the names of images, of which `sizes` (width, height) are given, that are to be extracted coarse first:
    those that are large for the cap. None where there are masks: features under them count for the cap and are not
    kept."""
    if masks is not None or not may_start_coarse(extraction):
        return []
    most = extraction.eff_max_image_size()
    pixels = {name: w * h * min(1.0, most / max(w, h)) ** 2 for name, (w, h) in sizes.items()}
    return [name for name, count in pixels.items() if is_large(count, extraction)]


def extract_coarse_first(
    database: Path,
    grey: Path,
    names: Sequence[str],
    coarse: Sequence[str],
    extraction: pycolmap.FeatureExtractionOptions,
    progress: Progress,
    rows: Callable[[], int] | None = None,
    **given: Any,
) -> None:
    """Extract the named images, of which `coarse` are tried without COLMAP's finest octave; those of them that stay
    below the cap are then extracted with it, as all others. `rows` returns how many images have features; `given` goes
    to `pycolmap.extract_features`.

    Images with features in the database keep them, but for those of an interrupted run that stayed below the cap.
    Raises `NativeError`, `Cancelled`.
    """

    threads = extraction.num_threads if extraction.num_threads > 0 else local_workers()
    reported = 0

    def extract(folder: Path, some: Sequence[str], options: pycolmap.FeatureExtractionOptions) -> None:
        before = reported

        def done() -> int:
            nonlocal reported
            reported = max(reported, rows() if rows else 0)
            return reported - before

        called(
            pycolmap.extract_features,
            database,
            folder,
            image_names=list(some),
            extraction_options=options,
            progress=progress,
            units_done=done if rows else None,
            **given,
        )

    left = _without_features(database, coarse)
    at_once = _evenly(len(left), threads)
    for begin in range(0, len(left), at_once):
        with task_folder() as folder:
            some = left[begin : begin + at_once]
            if written := write_as_doubled(grey, some, folder, extraction.eff_max_image_size(), threads):
                extract(folder, written, _without_finest(extraction))
    if coarse:
        _remove_features(database, _short_of_the_cap(database, coarse, extraction))
    extract(grey, names, extraction)


def _evenly(images: int, threads: int) -> int:
    """Return how many images to take at a time, so that few threads wait for others at the ends."""
    times = -(-images // (_AT_ONCE * threads))
    return max(1, -(-images // max(1, times * threads))) * threads


def _without_features(database: Path, names: Sequence[str]) -> list[str]:
    """Return those of the named images that have no features in the database."""
    if not names:
        return []
    with pycolmap.Database.open(database) as opened:
        done = {str(i.name) for i in opened.read_all_images() if opened.exists_keypoints(i.image_id)}
    return [name for name in names if name not in done]


def _without_finest(extraction: pycolmap.FeatureExtractionOptions) -> pycolmap.FeatureExtractionOptions:
    """Return options that begin with the image's own resolution."""
    changed = deepcopy(extraction)
    changed.sift.first_octave += 1
    changed.sift.num_octaves -= 1
    changed.sift.peak_threshold *= _THRESHOLD
    changed.sift.max_num_features = round(_CAP * changed.sift.max_num_features)
    return changed


def _short_of_the_cap(
    database: Path, names: Collection[str], extraction: pycolmap.FeatureExtractionOptions
) -> list[int]:
    """Return the ids of those of the named images that have no more places than the cap, and no feature of the finest
    octave: COLMAP, which keeps whole levels until they are more, would keep some of it."""
    most, cap = extraction.eff_max_image_size(), extraction.sift.max_num_features
    with pycolmap.Database.open(database) as opened:
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        short = []
        for image in opened.read_all_images():
            if str(image.name) not in set(names) or not opened.exists_keypoints(image.image_id):
                continue
            camera = cameras[image.camera_id]
            pixel = max(1.0, max(camera.width, camera.height) / most)
            keypoints = np.asarray(opened.read_keypoints(image.image_id), np.float32)
            if places(keypoints) <= cap and not _has_finest(keypoints, pixel):
                short.append(image.image_id)
    return short


def places(keypoints: NDArray[np.float32]) -> int:
    """Return the number of different places of keypoints, (N, 4 or 6): the cap counts these, and a place has a feature
    for each direction."""
    return len(np.unique(keypoints[:, :2], axis=0)) if len(keypoints) else 0


def _has_finest(keypoints: NDArray[np.float32], pixel: float) -> bool:
    """Tell whether any of (N, 6) keypoints, x, y and the affine shape a11 a12 a21 a22, comes from the doubled image."""
    return bool((np.hypot(keypoints[:, 2], keypoints[:, 4]) < _FINEST_SIZE * pixel).any())


def _remove_features(database: Path, ids: Iterable[int]) -> None:
    """Remove the features of images, so that COLMAP extracts them again. Raises `NativeError`."""
    rows = [(image_id,) for image_id in ids]
    with writing(database) as opened:
        for table in ("keypoints", "descriptors"):
            opened.executemany(f"DELETE FROM {table} WHERE image_id = ?", rows)
