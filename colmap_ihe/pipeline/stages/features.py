"""Find features in the grey images, into COLMAP's database."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from colmap_ihe.colmap import features
from colmap_ihe.colmap.coarse_first import is_large, may_start_coarse
from colmap_ihe.colmap.database import database_is_sound, looks_whole, remove_database
from colmap_ihe.colmap.extraction import extraction_bytes, extraction_options
from colmap_ihe.colmap.features import FeatureCounts
from colmap_ihe.colmap.lower_thresholds import COLMAPS_THRESHOLD, LOWEST, SCALES, UNIT, lowers_thresholds
from colmap_ihe.colmap.second_features import add_second_features
from colmap_ihe.colmap.tried_features import TriedFeatures
from colmap_ihe.dense.cost import pixels_within
from colmap_ihe.dense.undistort import read_grey
from colmap_ihe.errors import OptionError
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline.given_calibration import given_calibration, held_cameras
from colmap_ihe.pipeline.input_digests import digest_if_there, masks_in
from colmap_ihe.pipeline.masks import make_masks
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.second_grey import pictures_of, second_of
from colmap_ihe.pipeline.stage import Count, Inputs, RunContext, Stage, StageRecord, StrictModel
from colmap_ihe.pipeline.warnings import cameras as camera_warnings
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_KEYPOINT = 160  # bytes on disk of a feature with its descriptor, of COLMAP's four floats, six or 128 bytes
_FEATURES = 1.8  # for each that COLMAP is asked for at the most: directions of a place, and more places at five scales
_FEATURES_A_PIXEL = 0.02  # of a small photograph
_STAYS_BELOW = 650_000  # pixels of a photograph with fewer features than COLMAP's cap
_COARSE_FIRST = 0.3  # of the time of an image, without the doubled one
FEWER_FEATURES = "a smaller features.colmap.sift.max_num_features"
_COLMAPS_LARGEST = 3200  # pixels along the longer side, of images in which features are sought


class _CalibrationRecord(StrictModel):
    camera_ids: Sequence[Count] = ()


class FeaturesRecord(StageRecord):
    """Count images, cameras, those with a focal length from EXIF, features with those that are of the second grey, and
    photographs that were extracted again at a lower threshold; tell which cameras, by id, start from the calibration
    file."""

    images: Count
    cameras: Count
    with_focal_prior: Count
    features: Count
    of_second: Count = 0
    extracted_again: Count = 0
    calibration: _CalibrationRecord = _CalibrationRecord()


def run(run: RunContext, progress: Progress) -> FeaturesRecord:
    """Find features in all grey images."""
    project = run.project
    set_warnings.require_two([c.name for c in run.captures()], run.contents)
    if not database_is_sound(project.database):
        remove_database(project.database)
    masks, warnings = make_masks(
        project, run.records["convert"]["grey"], run.records["captures"].get("paired", {})
    )
    counts = features.extract_features(
        project.database,
        project.grey,
        run.grey_names(),
        masks,
        run.options.camera,
        run.options.features,
        project.workspace,
        run.executor,
        progress,
        calibration=given_calibration(project, run.options),
        tried=_tried(run),
    )
    remove_database(project.tried_features)
    counts, of_second = _with_second(run, counts, masks, progress)
    by_grey = run.photographs_by_grey()
    left_out = {
        by_grey[name]: "COLMAP did not take its grey image; with camera.mode single all need the same size"
        for name in counts.missing
    }
    set_warnings.require_features(counts.features, counts.images)
    warnings += set_warnings.poor_photographs({by_grey[n]: c for n, c in counts.poor.items()})
    held_cameras(project, run.options, asdict(counts))  # what cannot be held is refused before matching
    if run.options.camera.params is None:
        warnings += camera_warnings.focal_length_warnings(counts.images, counts.with_focal_prior)
        warnings += camera_warnings.shared_camera_warnings(counts.assumed)
    warnings += camera_warnings.calibration_warnings(counts.calibration, by_grey)
    return FeaturesRecord(**asdict(counts), of_second=of_second, left_out=left_out, warnings=warnings)


def _tried(run: RunContext) -> TriedFeatures:
    grey = run.project.grey
    return TriedFeatures(
        run.project.tried_features, run.photographs_by_grey(), lambda name: read_grey(grey / name)
    )


def _with_second(
    run: RunContext, counts: FeatureCounts, masks: Path | None, progress: Progress
) -> tuple[FeatureCounts, int]:
    """Add the features of the second grey, if there is one: return the counts with them, and how many they are."""
    second, database = second_of(run.records), run.project.database
    if second is None:
        return counts, 0
    pictures, names = pictures_of(run.project, second, masks), run.grey_names()
    added = add_second_features(database, names, pictures, run.options.features, run.executor, progress)
    now = features.count_features(database, names)
    return replace(counts, features=now.features, poor=now.poor), sum(added.values())


def features_an_image(options: Options, size: PhotoSetSize) -> float:
    """Return about how many features COLMAP finds in an image of the set."""
    most: int = extraction_options(options.features).sift.max_num_features
    return min(_FEATURES * most, _FEATURES_A_PIXEL * size.pixels / max(1, size.images))


def _check(options: Options, images: int) -> None:
    camera = options.camera
    if camera.fixed and camera.params is None and camera.calibration is None:
        raise OptionError(
            "camera.fixed holds a calibration that was given, and none is",
            hint="give camera.calibration, or camera.model with camera.params",
        )
    features.native_options(options.camera, options.features)


def _result_options(options: Options) -> dict[str, Any]:
    """Leave out what has no effect on features: whether cameras are held, where the calibration file lies, whose
    content counts, and a peak threshold that is COLMAP's own, which only keeps images from being extracted again."""
    values = options.sections("camera", "features")
    if lowers_thresholds(options.features):
        values["lowest_threshold"] = [LOWEST, SCALES]
    else:
        values["features"]["colmap"] = _without_colmaps_threshold(values["features"]["colmap"])
    if options.features.octaves == "colmap":
        del values["features"]["octaves"]  # as before it was an option
    del values["camera"]["fixed"], values["camera"]["calibration"]
    if options.camera.calibration is not None:
        values["camera"]["calibration"] = True
    return values


def _without_colmaps_threshold(colmap: Mapping[str, Any]) -> dict[str, Any]:
    sift = dict(colmap.get("sift", {}))
    if sift.get("peak_threshold") != COLMAPS_THRESHOLD:
        return dict(colmap)
    del sift["peak_threshold"]
    others = {name: value for name, value in colmap.items() if name != "sift"}
    return others | {"sift": sift} if sift else others


def _inputs(
    project: Project, options: Options, discovery: Discovery, digests: Mapping[str, Sequence[Any]]
) -> Inputs:
    masks = {"masks": masks_in(project.masks)}
    if options.camera.calibration is None:
        return masks
    return masks | {"calibration": {"its file": digest_if_there(project.root / options.camera.calibration)}}


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    memory = extraction_bytes([size.largest_sides], extraction_options(options.features), 1)
    disk = round(size.images * features_an_image(options, size) * _KEYPOINT)
    return StageNeeds("features", BASE_BYTES, memory, disk, saves="a smaller features.max_image_size")


def _starts_coarse(options: Options, pixels: float) -> bool:
    extraction = extraction_options(options.features)
    return (
        options.features.octaves == "auto" and is_large(pixels, extraction) and may_start_coarse(extraction)
    )


def _parts(options: Options, known: Known) -> list[Part]:
    largest = options.features.max_image_size or _COLMAPS_LARGEST
    megapixels = pixels_within(largest, known.images, known.pixels) / 1e6
    share = _COARSE_FIRST if _starts_coarse(options, 1e6 * megapixels / max(1, known.images)) else 1.0
    parts = [Part("features", "images", share * 0.55 * megapixels + 0.4 * known.images)]
    if lowers_thresholds(options.features) and known.pixels < _STAYS_BELOW * known.images:
        parts.append(Part("features", UNIT, 0.8 * megapixels + 0.4 * known.images))
    return parts


STAGE = Stage(
    "features",
    run,
    FeaturesRecord,
    sections=("camera", "features"),
    libraries=("pycolmap",),
    result_options=_result_options,
    inputs=_inputs,
    files=lambda project, record: [project.database],
    made=lambda project: [project.database],
    remove=lambda project: remove_database(project.database),
    is_sound=lambda project: looks_whole(project.database),
    check=_check,
    needs=_needs,
    parts=_parts,
)
