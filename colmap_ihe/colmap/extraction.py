"""Set up COLMAP's extraction of features: its options, its memory, and a database of features alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.coarse_first import extract_coarse_first
from colmap_ihe.colmap.native import apply_options, pycolmap
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import FeaturesOptions

_BYTES_A_PIXEL = (
    290  # of SIFT on the CPU, from twice the size of the image on: 280 measured, of one and two threads
)


def extraction_options(options: FeaturesOptions, threads: int = -1) -> pycolmap.FeatureExtractionOptions:
    """Return pycolmap's options for features; `threads` unless the user gives a number. Raises `OptionError`."""
    extraction = pycolmap.FeatureExtractionOptions(num_threads=threads)
    if options.max_image_size is not None:
        extraction.max_image_size = options.max_image_size
    return apply_options(extraction, options.colmap, "features.colmap")


def extraction_bytes(
    sizes: Sequence[tuple[int, int]], extraction: pycolmap.FeatureExtractionOptions, threads: int
) -> int:
    """Return the bytes of memory for features of images of these sizes (width, height), on so many threads unless
    the options give a number."""
    most = extraction.eff_max_image_size()
    pixels = max((w * h * min(1.0, most / max(w, h)) ** 2 for w, h in sizes), default=0.0)
    threads = extraction.num_threads if extraction.num_threads > 0 else threads
    return round(_BYTES_A_PIXEL * pixels * 4.0 ** -(extraction.sift.first_octave + 1) * threads)


def extract_apart(
    database: Path,
    grey: Path,
    masks: Path | None,
    names: Sequence[str],
    extraction: pycolmap.FeatureExtractionOptions,
    progress: Progress,
    coarse: Sequence[str] = (),
) -> None:
    """Write a new database with the features of the named images, of which `coarse` are extracted coarse first; its
    cameras are of no account. Raises as `extract_features`."""
    reader = pycolmap.ImageReaderOptions()
    if masks is not None:
        reader.mask_path = masks
    pycolmap.Database.open(database).close()
    given: dict[str, Any] = {"camera_mode": pycolmap.CameraMode.PER_IMAGE, "reader_options": reader}
    extract_coarse_first(database, grey, names, coarse, extraction, progress, **given)
