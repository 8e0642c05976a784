"""Map: find cameras and points from the verified matches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from colmap_ihe.colmap import mapping
from colmap_ihe.colmap.calibration import calibrate
from colmap_ihe.colmap.measures import cameras_of_images, has_turned_sizes
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import MappingError
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.photographs.camera_identity import identities_of_cameras, read_identities, turned_partners
from colmap_ihe.pipeline.given_calibration import held_cameras
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Count, Record, RunContext, Stage, StageRecord, StrictModel
from colmap_ihe.pipeline.stages.features import FEWER_FEATURES, features_an_image
from colmap_ihe.pipeline.warnings import cameras as camera_warnings
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


class _CameraRecord(StrictModel):
    """Describe a camera of the largest model: its parameters in COLMAP's order, by the names that COLMAP has for them,
    with their standard deviations, 0 for what was held, and pairs that are correlated so that one may stand for the
    other. `by`: what its parameters are from, "calibration", "colmap" or "given" and held."""

    camera_id: Count
    model: str
    width: Count
    height: Count
    names: list[str]
    params: list[float]
    standard_deviations: list[float] | None
    correlated: list[tuple[str, str, float]]
    photographs: Count
    by: str


class _HeldOutRecord(StrictModel):
    """Hold the median reprojection error of points held out, in pixels, and by how many standard errors the model
    chosen is better than COLMAP's."""

    colmap_px: float
    calibrated_px: float
    standard_errors: float


class SparseRecord(StageRecord):
    """Describe each model, the largest first; `unregistered` photographs of that one by name, its `cameras`, and what
    calibrating them brought (`held_out`), if they were."""

    models: Annotated[list[_ModelRecord], Field(min_length=1)]
    unregistered: list[str]
    cameras: Annotated[list[_CameraRecord], Field(default_factory=list)]
    held_out: _HeldOutRecord | None = None


def run(run: RunContext, progress: Progress) -> SparseRecord:
    """Map the images and look for what is doubtful about the model."""
    project, by_grey = run.project, run.photographs_by_grey()
    images = run.records["features"]["images"]
    held = held_cameras(project, run.options, run.records["features"])
    try:
        mapped = mapping.map_images(
            project.database,
            project.grey,
            project.sparse,
            run.options.sparse,
            images,
            progress,
            colour=project.colour,
            known=calibrate.Known(
                held=held,
                partners=_partners(project, run.grey_names()),
                given_model=run.options.camera.model != "auto",
                check_shared=run.options.camera.mode == "auto" and run.options.camera.params is None,
            ),
        )
    except MappingError as error:
        reason, hint = model_warnings.why_no_model(project.database, images)
        raise MappingError(reason, hint) from error
    models = mapped.models
    missing = sorted(by_grey[n] for n in run.grey_names() if n not in models[0].image_names)
    found_again = run.records["matches"].get("found_again", 1.0)
    warnings = model_warnings.model_warnings(
        models, project.sparse, project.database, by_grey, missing, found_again
    )
    warnings += camera_warnings.apart_warnings([[by_grey[name] for name in group] for group in mapped.apart])
    described = [_ModelRecord(**asdict(model)) for model in models]
    cameras, held_out = _cameras(project, mapped.calibration, held)
    warnings += camera_warnings.doubtful_calibrations([camera.model_dump() for camera in cameras])
    return SparseRecord(
        models=described, unregistered=missing, cameras=cameras, held_out=held_out, warnings=warnings
    )


def _cameras(
    project: Project, found: calibrate.Calibration | None, held: frozenset[int]
) -> tuple[list[_CameraRecord], _HeldOutRecord | None]:
    model = pycolmap.Reconstruction(project.sparse / "0")
    photographs = Counter(model.images[i].camera_id for i in model.reg_image_ids())
    cameras = []
    for camera_id, count in sorted(photographs.items(), key=lambda item: (-item[1], item[0])):
        camera = model.cameras[camera_id]
        deviations = found.deviations.get(camera_id) if found else None
        by = "calibration" if deviations else "given" if camera_id in held else "colmap"
        cameras.append(
            _CameraRecord(
                camera_id=camera_id,
                model=camera.model_name,
                width=camera.width,
                height=camera.height,
                names=camera.params_info.replace(" ", "").split(","),
                params=[float(value) for value in camera.params],
                standard_deviations=list(deviations.values) if deviations else None,
                correlated=list(deviations.correlated) if deviations else [],
                photographs=count,
                by=by,
            )
        )
    if found is None:
        return cameras, None
    gain = found.gain
    return cameras, _HeldOutRecord(
        colmap_px=gain.colmap_px, calibrated_px=gain.chosen_px, standard_errors=gain.standard_errors
    )


def _partners(project: Project, grey_names: Sequence[str]) -> list[tuple[int, int]]:
    """Return the cameras, by pairs of ids, that are one whose pictures an editor turned."""
    if not has_turned_sizes(project.database):
        return []
    found = read_identities(project.grey, grey_names)
    return turned_partners(identities_of_cameras(cameras_of_images(project.database), found))


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
