"""Map: find cameras and points from the verified matches."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from colmap_ihe.colmap import mapping
from colmap_ihe.errors import MappingError
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.pipeline.given_calibration import held_cameras
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Count, Record, RunContext, Stage, StageRecord, StrictModel
from colmap_ihe.pipeline.stages.features import FEWER_FEATURES, features_an_image
from colmap_ihe.pipeline.warnings import model as model_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_FEATURE = 45  # bytes on disk of a feature, in the model


class _ModelRecord(StrictModel):
    registered_images: Count
    points3d: Count
    points_over_3_views: Count
    mean_track_length: float
    mean_reprojection_error_px: float


class SparseRecord(StageRecord):
    """Describe each model, the largest first; `unregistered` photographs of that one by name."""

    models: Annotated[list[_ModelRecord], Field(min_length=1)]
    unregistered: list[str]


def run(run: RunContext, progress: Progress) -> SparseRecord:
    """Map the images and look for what is doubtful about the model."""
    project, by_grey = run.project, run.photographs_by_grey()
    images = run.records["features"]["images"]
    try:
        models = mapping.map_images(
            project.database,
            project.grey,
            project.sparse,
            run.options.sparse,
            images,
            progress,
            colour=project.colour,
            held=held_cameras(project, run.options, run.records["features"]),
        )
    except MappingError as error:
        reason, hint = model_warnings.why_no_model(project.database, images)
        raise MappingError(reason, hint) from error
    missing = sorted(by_grey[n] for n in run.grey_names() if n not in models[0].image_names)
    found_again = run.records["matches"].get("found_again", 1.0)
    warnings = model_warnings.model_warnings(
        models, project.sparse, project.database, by_grey, missing, found_again
    )
    described = [_ModelRecord(**asdict(model)) for model in models]
    return SparseRecord(models=described, unregistered=missing, warnings=warnings)


def _result_options(options: Options) -> dict[str, Any]:
    values = options.sections("sparse")
    return values | {"camera": {"fixed": True}} if options.camera.fixed else values


def _files(project: Project, record: Record) -> list[Path]:
    names = ("cameras.bin", "images.bin", "points3D.bin")
    return [project.sparse / str(n) / name for n in range(len(record["models"])) for name in names]


def _check(options: Options, images: int) -> None:
    mapping.native_options(options.sparse)


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    features = size.images * features_an_image(options, size)
    memory, disk = BASE_BYTES + round(400 * features), round(features * _FEATURE)
    return StageNeeds("sparse", memory, 0, disk, saves=FEWER_FEATURES)


def _parts(options: Options, known: Known) -> list[Part]:
    return [
        Part("sparse", "images", 1e-4 * known.inliers),
        Part("sparse", "coloured models", 0.02 * known.registered_megapixels),
    ]


STAGE = Stage(
    "sparse",
    run,
    SparseRecord,
    sections=("sparse",),
    result_options=_result_options,
    files=_files,
    made=lambda project: [project.sparse, *project.workspace.glob(".sparse.*")],
    check=_check,
    needs=_needs,
    parts=_parts,
)
