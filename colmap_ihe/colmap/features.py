"""Write cameras from EXIF and features of the grey images into the database."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.calibration_file import CalibratedCamera
from colmap_ihe.colmap.coarse_first import coarse_names, extract_coarse_first
from colmap_ihe.colmap.database import counting_rows
from colmap_ihe.colmap.extraction import extraction_bytes, extraction_options
from colmap_ihe.colmap.features_on_workers import extract_in_shards
from colmap_ihe.colmap.image_import import assumed, image_groups, import_images
from colmap_ihe.colmap.known_calibration import CalibrationUse, KnownCalibration, use_of
from colmap_ihe.colmap.lower_thresholds import count_extracted_again, extract_again, lowers_thresholds
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.tried_features import TriedFeatures, copy_tried
from colmap_ihe.errors import NativeError, OptionError
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import shares_memory
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.camera_identity import read_identities
from colmap_ihe.project.options import CameraOptions, FeaturesOptions

FEW = 100
"""Features of an image below which it can hardly be registered: COLMAP needs 30 matches of them."""


@dataclass(frozen=True)
class FeatureCounts:
    """Count what is in the database. `missing`: names of grey images that COLMAP did not take; `poor`: features of
    those with fewer than `FEW`, by name; `assumed`: the number of images of each camera that several share though EXIF
    does not say so; `extracted_again`: images that stayed below COLMAP's cap and have features of a lower threshold."""

    images: int
    cameras: int
    camera_model: str
    with_focal_prior: int
    features: int
    missing: tuple[str, ...]
    poor: dict[str, int]
    assumed: tuple[int, ...] = ()
    extracted_again: int = 0
    calibration: CalibrationUse = field(default_factory=CalibrationUse)


def extract_features(
    database: Path,
    grey: Path,
    names: Sequence[str],
    masks: Path | None,
    camera: CameraOptions,
    options: FeaturesOptions,
    scratch: Path,
    executor: Executor,
    progress: Progress,
    *,
    calibration: Sequence[CalibratedCamera] = (),
    tried: TriedFeatures | None = None,
) -> FeatureCounts:
    """Extract SIFT features of the named images below `grey`; those that are in the database are left alone, and those
    that were `tried` are copied.

    COLMAP extracts them on threads here, or on the workers of an executor of another kind, with the same result;
    unfinished work lies in `scratch`. Cameras that are in `calibration` start from it. COLMAP gets every name: it would
    else read all that lies in the folder, RAW thumbnails included. Raises `OptionError`, `NativeError`, `Cancelled`.
    """
    reader, extraction = native_options(camera, options)
    if masks is not None:
        reader.mask_path = masks
    progress.start(len(names))
    shutil.rmtree(parts := scratch / "parts", ignore_errors=True)  # of a run that was interrupted
    mode = getattr(pycolmap.CameraMode, camera.mode.upper())
    identities = read_identities(grey, names) if camera.mode == "auto" or calibration else {}
    groups = image_groups(names, mode, identities)
    known = KnownCalibration(calibration, identities)
    if not database.exists():
        import_images(database, grey, groups, reader, known, progress)
    if tried is not None:
        copy_tried(tried, database, masks, options)
    sizes = _sizes(database)
    coarse = coarse_names(sizes, extraction, masks) if options.octaves == "auto" else []
    given: dict[str, Any] = {"camera_mode": mode, "reader_options": reader}
    if shares_memory(executor):
        if extraction.num_threads <= 0:
            needed = extraction_bytes(list(sizes.values()), extraction, 1)
            extraction.num_threads = memory.workers_for("features", needed, local_workers())
        with counting_rows(database, "keypoints") as rows:
            extract_coarse_first(database, grey, names, coarse, extraction, progress, rows, **given)
    else:
        extract_in_shards(database, grey, masks, options, coarse, parts, executor, progress)
    if lowers_thresholds(options):
        threads = extraction.num_threads
        extract_again(database, grey, masks, options, threads, parts, executor, progress)
    counts = count_features(database, names)
    if not counts.images:
        raise NativeError(
            "COLMAP took none of the grey images",
            hint="records/colmap.log.* says why; with camera.mode single all images need the same size",
        )
    return replace(counts, assumed=assumed(groups), calibration=use_of(database, known))


def _sizes(database: Path) -> dict[str, tuple[int, int]]:
    """Return the width and height of each image, by name."""
    with pycolmap.Database.open(database) as opened:
        cameras = {c.camera_id: (c.width, c.height) for c in opened.read_all_cameras()}
        return {str(image.name): cameras[image.camera_id] for image in opened.read_all_images()}


def count_features(database: Path, names: Sequence[str]) -> FeatureCounts:
    """Return the counts of a database for grey images of these names."""
    with pycolmap.Database.open(database) as opened:
        images = opened.read_all_images()
        cameras = {c.camera_id: c for c in opened.read_all_cameras()}
        features = opened.num_keypoints()
        by_name = {str(i.name): int(opened.num_keypoints_for_image(i.image_id)) for i in images}
    present = {image.name for image in images}
    return FeatureCounts(
        images=len(images),
        cameras=len(cameras),
        camera_model=min((c.model.name for c in cameras.values()), default=""),
        with_focal_prior=sum(cameras[i.camera_id].has_prior_focal_length for i in images),
        features=features,
        missing=tuple(sorted(set(names) - present)),
        poor={name: count for name, count in sorted(by_name.items()) if count < FEW},
        extracted_again=count_extracted_again(database),
    )


def native_options(
    camera: CameraOptions, options: FeaturesOptions
) -> tuple[pycolmap.ImageReaderOptions, pycolmap.FeatureExtractionOptions]:
    """Return pycolmap's options for reading images with their cameras, and for features. Raises `OptionError`."""
    model = "SIMPLE_RADIAL" if camera.model == "auto" else camera.model
    reader = pycolmap.ImageReaderOptions()
    models = [m for m in pycolmap.CameraModelId.__members__ if m != "INVALID"]
    if model not in models:
        raise OptionError(f"camera.model: unknown model {model!r}", hint=f"COLMAP knows {', '.join(models)}")
    reader.camera_model = model
    if camera.params is not None:
        expected = len(pycolmap.Camera.create_from_model_name(1, model, 1.0, 1, 1).params)
        if len(camera.params) != expected:
            raise OptionError(f"camera.params: {len(camera.params)} numbers, {model} has {expected}")
        reader.camera_params = ", ".join(repr(p) for p in camera.params)
    return reader, extraction_options(options)
