"""Map: find cameras and points from the verified matches."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from colmap_ihe.colmap import mapping
from colmap_ihe.colmap.calibration.calibrate import MOST_IMAGES, Known
from colmap_ihe.colmap.mapper_options import native_options
from colmap_ihe.colmap.second_try import SecondTry
from colmap_ihe.errors import MappingError
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.pipeline import resource_needs
from colmap_ihe.pipeline.camera_records import CameraRecord, HeldOutRecord, camera_records, turned_cameras
from colmap_ihe.pipeline.given_calibration import held_cameras
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Count, Record, RunContext, Shortfall, Stage, StageRecord, StrictModel
from colmap_ihe.pipeline.stages.features import FEWER_FEATURES, features_an_image
from colmap_ihe.pipeline.warnings import cameras as camera_warnings
from colmap_ihe.pipeline.warnings import model as model_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_FEATURE = 45  # bytes on disk of a feature, in the model
_CALIBRATED = 4_000_000  # bytes of memory for an image, of 600 points that five images see
_SURE = 3  # photographs; where only two see a point, nothing checks it


class _ModelRecord(StrictModel):
    registered_images: Count
    points3d: Count
    points_over_3_views: Count
    mean_track_length: float
    mean_reprojection_error_px: float


class SparseRecord(StageRecord):
    """Describe each model, the largest first; `unregistered` photographs of that one by name, its `cameras`, and what
    calibrating them brought (`held_out`), if they were. `second_try`: as `SecondTry`, where there was one."""

    models: Annotated[list[_ModelRecord], Field(min_length=1)]
    unregistered: list[str]
    cameras: Annotated[list[CameraRecord], Field(default_factory=list)]
    held_out: HeldOutRecord | None = None
    second_try: dict[str, Any] | None = None


def run(run: RunContext, progress: Progress) -> SparseRecord:
    """Map the images and look for what is doubtful about the model."""
    project, by_grey = run.project, run.photographs_by_grey()
    images = run.records["features"]["images"]
    held = held_cameras(project, run.options, run.records["features"])
    tries: list[SecondTry] = []
    try:
        mapped = mapping.map_images(
            project.database,
            project.grey,
            project.sparse,
            run.options.sparse,
            images,
            progress,
            colour=project.colour,
            known=_known(run, held),
            on_second_try=tries.append,
        )
    except MappingError as error:
        reason, hint = model_warnings.why_no_model(project.database, images)
        raise MappingError("; ".join([reason, *(each.in_words() for each in tries)]), hint) from error
    models = mapped.models
    missing = sorted(by_grey[n] for n in run.grey_names() if n not in models[0].image_names)
    found_again = run.records["matches"].get("found_again", 1.0)
    warnings = model_warnings.model_warnings(
        models, project.sparse, project.database, by_grey, missing, found_again
    )
    described = [_ModelRecord(**asdict(model)) for model in models]
    cameras, held_out = camera_records(project, mapped.calibration, held)
    warnings = [
        *(each.in_words() for each in tries),
        *warnings,
        *mapped.problems,
        *camera_warnings.apart_warnings([[by_grey[name] for name in group] for group in mapped.apart]),
        *camera_warnings.doubtful_calibrations([camera.model_dump() for camera in cameras]),
        *camera_warnings.refused_calibrations(mapped.calibration.gain if mapped.calibration else None),
    ]
    record = SparseRecord(
        models=described, unregistered=missing, cameras=cameras, held_out=held_out, warnings=warnings
    )
    if tries:
        record.second_try = asdict(tries[0])
    return record


def _known(run: RunContext, held: frozenset[int]) -> Known:
    camera = run.options.camera
    return Known(
        held=held,
        partners=turned_cameras(run.project, run.grey_names()),
        given_model=camera.model != "auto",
        check_shared=camera.mode == "auto" and camera.params is None,
    )


def are_too_few(registered: int, images: int, options: Options) -> bool:
    """Tell whether a model holds too few of so many `images` to count as a success: less than `sparse.min_registered`
    of them, or two of more. Where that is 0, every model counts."""
    least = options.sparse.min_registered
    return least > 0 and registered < images and (registered < _SURE or registered < least * images)


def _shortfall(options: Options, record: Record) -> Shortfall | None:
    registered = record["models"][0]["registered_images"]
    images = registered + len(record["unregistered"])
    if not are_too_few(registered, images, options):
        return None
    return Shortfall(
        f"the largest model holds only {registered} of {images} photographs, too few to go on with; it is kept in"
        " workspace/sparse/0",
        "the warnings say why, photograph by photograph; to go on with these all the same, `--set"
        " sparse.min_registered=0`",
    )


def _result_options(options: Options) -> dict[str, Any]:
    values = options.sections("sparse")
    del values["sparse"]["min_registered"]
    if options.sparse.calibration == "colmap":  # as before there was another
        del values["sparse"]["calibration"]
    return values | {"camera": {"fixed": True}} if options.camera.fixed else values


def _files(project: Project, record: Record) -> list[Path]:
    names = ("cameras.bin", "images.bin", "points3D.bin")
    return [project.sparse / str(n) / name for n in range(len(record["models"])) for name in names]


def _check(options: Options, images: int) -> None:
    native_options(options.sparse)


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    features = size.images * features_an_image(options, size)
    calibrated = _CALIBRATED * min(size.images, MOST_IMAGES) if options.sparse.calibration == "auto" else 0
    memory, disk = BASE_BYTES + round(400 * features) + calibrated, round(features * _FEATURE)
    return StageNeeds("sparse", memory, 0, disk, saves=FEWER_FEATURES)


def _parts(options: Options, known: resource_needs.Known) -> list[Part]:
    steps = Part("sparse", "calibration steps", 0.3 * min(known.images, MOST_IMAGES))
    return [
        Part("sparse", "images", 1e-4 * known.inliers),
        *([steps] if options.sparse.calibration == "auto" else []),
        Part("sparse", "coloured models", 0.02 * known.registered_megapixels),
    ]


STAGE = Stage(
    "sparse",
    run,
    SparseRecord,
    result_options=_result_options,
    files=_files,
    made=lambda project: [project.sparse, *project.workspace.glob(".sparse.*")],
    check=_check,
    shortfall=_shortfall,
    needs=_needs,
    parts=_parts,
)
