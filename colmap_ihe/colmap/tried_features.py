"""Keep features of pictures, each named after its content, with the verified matches of pairs of them.

What a trial of greys finds in the grey that it chooses is what a reconstruction would find again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.array_features import U8, extract_arrays
from colmap_ihe.colmap.extraction import extraction_options
from colmap_ihe.colmap.matching_in_blocks import BlockMatching, match_in_processes
from colmap_ihe.colmap.native import cuda_devices, pycolmap
from colmap_ihe.colmap.part_databases import Pair, copy_features, write_images
from colmap_ihe.machine.libraries import library_versions
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import FeaturesOptions, MatchesOptions

_CONTENT = 64  # characters of the name of a content
_FOCAL = 1.2  # of the longer side, as COLMAP takes it where nobody says


@dataclass(frozen=True, eq=False)
class PairMatches:
    """Hold the matches of two images. `features`: those of both; `putative`: matches before verification; `places`:
    (N, 2) float64, x and y of the verified ones in the first image, in pixels."""

    features: int
    putative: int
    places: NDArray[np.float64]


@dataclass(frozen=True)
class TriedFeatures:
    """Hold features that were found in a trial. `captures`: the name of the photograph by that of its grey image;
    `read` returns a grey image, (H, W) uint8, by that name."""

    database: Path
    captures: Mapping[str, str]
    read: Callable[[str], U8]


def content_of(grey: U8, options: FeaturesOptions) -> str:
    """Return a name for what COLMAP finds in a picture, (H, W) uint8, with these options."""
    found_by = [library_versions("pycolmap"), options.model_dump(mode="json"), grey.shape]
    digest = hashlib.sha256(json.dumps(found_by, sort_keys=True).encode())
    digest.update(grey.tobytes())
    return digest.hexdigest()


def add_pictures(
    database: Path, pictures: Sequence[tuple[str, U8]], options: FeaturesOptions, progress: Progress
) -> list[int]:
    """Write the features that a reconstruction with these options keeps of each picture, (H, W) uint8, of a photograph
    of this name: COLMAP's thresholds, its largest size of an image and its largest number of features, on the CPU.
    Return the id of each, from 1 on in the order in which they came.

    The same pictures give the same features. Raises `OptionError`, `NativeError`, `DiskFullError`, `Cancelled`.
    """
    extraction = extraction_options(options)
    extraction.use_gpu = False
    greys = [grey for _, grey in pictures]
    found = extract_arrays(greys, extraction, "features of pairs", progress, octaves=options.octaves)
    with pycolmap.Database.open(database) as opened:
        first = opened.num_images() + 1
    ids = list(range(first, first + len(pictures)))
    names = [f"{content_of(grey, options)} {capture}" for capture, grey in pictures]
    cameras = {image_id: _camera(image_id, grey) for image_id, (_, grey) in zip(ids, pictures, strict=True)}
    write_images(database, cameras, dict(zip(ids, names, strict=True)))
    sift = pycolmap.FeatureExtractorType.SIFT
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for image_id, (keypoints, descriptors) in zip(ids, found, strict=True):
            opened.write_keypoints(image_id, keypoints)
            opened.write_descriptors(image_id, pycolmap.FeatureDescriptors(sift, descriptors))
    return ids


def match_pictures(
    database: Path, pairs: Collection[Pair], parts: Path, progress: Progress
) -> dict[Pair, PairMatches]:
    """Match and verify pairs of pictures, each by their ids with the smaller one first, as COLMAP does by default with
    cameras of unknown focal length. `parts`: a folder that is not there, for unfinished work.

    The same pairs give the same matches. Raises `NativeError`, `DiskFullError`, `Cancelled`.
    """
    progress.start(len(pairs), "pairs tried")
    match_in_processes(BlockMatching(database, list(pairs), MatchesOptions(), parts, progress), 0)
    with pycolmap.Database.open(database) as opened:
        return {pair: _matches(opened, pair) for pair in pairs}


def _matches(opened: pycolmap.Database, pair: Pair) -> PairMatches:
    inliers = np.asarray(opened.read_two_view_geometry(*pair).inlier_matches, np.intp).reshape(-1, 2)
    places = np.asarray(opened.read_keypoints(pair[0]), np.float64)[:, :2]
    features = sum(opened.num_keypoints_for_image(image_id) for image_id in pair)
    return PairMatches(features, len(opened.read_matches(*pair)), places[inliers[:, 0]])


def copy_tried(tried: TriedFeatures, database: Path, masks: Path | None, options: FeaturesOptions) -> None:
    """Copy to a database the features of grey images that were tried: those which are, to the pixel, what was looked at
    with these options, and have no mask. Where a GPU finds features, which are others, nothing is copied."""
    if _on_gpu(options) or not tried.database.exists():
        return
    with pycolmap.Database.open(tried.database) as opened:
        known = {str(image.name): image.image_id for image in opened.read_all_images()}
    captures = {name[_CONTENT + 1 :] for name in known}
    with pycolmap.Database.open(database) as opened:
        images = {str(image.name): image.image_id for image in opened.read_all_images()}
    ids = {}
    for name, image_id in images.items():
        capture = tried.captures.get(name)
        if capture in captures and (masks is None or not (masks / f"{name}.png").exists()):
            content = f"{content_of(tried.read(name), options)} {capture}"
            if content in known:
                ids[known[content]] = image_id
    copy_features(tried.database, database, ids)


def _on_gpu(options: FeaturesOptions) -> bool:
    return bool(cuda_devices() and extraction_options(options).use_gpu)


def _camera(camera_id: int, grey: U8) -> pycolmap.Camera:
    height, width = grey.shape
    return pycolmap.Camera.create_from_model_name(
        camera_id, "SIMPLE_RADIAL", _FOCAL * max(width, height), width, height
    )
