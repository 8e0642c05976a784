"""Make the dense cloud: undistort, find depth, fuse."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from colmap_ihe.dense import backend, fusion
from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.dense.cloud import dense_cloud
from colmap_ihe.dense.cost import ASPECT, dense_cost, pixels_within
from colmap_ihe.dense.ply import read_ply
from colmap_ihe.errors import OptionError
from colmap_ihe.machine.files import require_room
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.machine.words import listed
from colmap_ihe.pipeline.outputs import size_of
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.second_grey import second_of
from colmap_ihe.pipeline.stage import Count, Record, RunContext, Stage, StageRecord
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.survey.cloud_file import missing_libraries, write_laz
from colmap_ihe.survey.frames import Frame

_ENOUGH = 0.4  # inliers for each feature: with fewer, photographs see so much less of each other
_LIKELY_POINTS = 0.1  # for each pixel with depth
_PLY, _LAZ = "fused.ply", "fused.laz"
POINTS_A_PIXEL = 0.15  # at the most


class DenseRecord(StageRecord):
    """Count the points of the cloud, the pixels that stereo looked at and those with depth. `laz`: the cloud of a model
    in metres lies there as LAZ too."""

    points: Count
    backend: str
    pixels: Count
    pixels_with_depth: Count
    laz: bool = False


def run(run: RunContext, progress: Progress) -> DenseRecord:
    """Make the dense cloud of the largest model."""
    project = run.project
    there = sum(map(size_of, _made(project)))
    values = dense_cloud(
        run.model_folder,
        project.grey,
        project.colour,
        project.made_masks,
        project.dense,
        run.options.dense,
        run.executor,
        progress,
        lambda needed: require_room(project.root, needed - there),
        second_of(run.records),
    )
    if not run.is_metric:
        return DenseRecord(**values)
    frame = Frame(**run.records["survey"]["frame"])
    if missing := missing_libraries(frame):
        warning = (
            f"the cloud is not written as LAZ, as {listed(missing)} {'is' if len(missing) == 1 else 'are'} not"
            " installed: pip install 'colmap-ihe[survey]', and run again with --from dense"
        )
        # Coordinates of a local system are in the PLY file too.
        told = [warning] if frame.crs else []
        return DenseRecord(**{**values, "warnings": [*values["warnings"], *told]})
    write_laz(project.dense / _LAZ, read_ply(project.dense / _PLY)["vertex"], frame)
    return DenseRecord(**values, laz=True)


def pixels_seen(options: Options, size: PhotoSetSize) -> float:
    """Return the pixels that dense stereo looks at."""
    return pixels_within(options.dense.max_image_size, size.images, size.pixels)


def likely_points(options: Options, known: Known) -> float:
    """Return the points that the cloud has, or likely will have."""
    if known.points is not None:
        return known.points
    return 1e6 * _megapixels_seen(options, known) * _overlap(known) * _LIKELY_POINTS


def _megapixels_seen(options: Options, known: Known) -> float:
    return (
        pixels_within(options.dense.max_image_size, known.registered, 1e6 * known.registered_megapixels) / 1e6
    )


def _overlap(known: Known) -> float:
    return min(1.0, known.inliers / max(1, known.features) / _ENOUGH)


def _result_options(options: Options) -> dict[str, Any]:
    values = options.sections("dense")
    enabled = values["dense"].pop("enabled")
    values["dense"]["backend"] = pick_backend(options.dense.backend) if enabled else "none"
    return values


def _made(project: Project) -> list[Path]:
    """List what this stage makes in a folder that it shares with `mesh`."""
    return [path for path in project.dense.glob("*") if not path.name.startswith("mesh.")]


def _files(project: Project, record: Record) -> list[Path]:
    names = [_PLY, _LAZ] if record.get("laz") else [_PLY]
    return [project.dense / name for name in names]


def _check(options: Options, images: int) -> None:
    if options.dense.enabled:
        if options.camera.model == "EQUIRECTANGULAR":
            raise OptionError(
                "camera.model is EQUIRECTANGULAR, of which dense stereo can make no flat images",
                hint="add --no-dense for a sparse model, or cut the panoramas into flat views",
            )
        pick_backend(options.dense.backend)
        fusion.fusion_options(options.dense.colmap)
        backend.patchmatch_options(options.dense.patchmatch)


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    name, seen = pick_backend(options.dense.backend), pixels_seen(options, size)
    one = dense_cost([size.largest_sides], options.dense.max_image_size, name, 1, 0)
    every = dense_cost([(round((seen * ASPECT) ** 0.5), round((seen / ASPECT) ** 0.5))], 10**9, name, 1, 0)
    return StageNeeds(
        "dense",
        BASE_BYTES,
        one.memory_bytes,
        every.disk_bytes,
        every.fusion_bytes,
        saves="a smaller dense.max_image_size",
    )


def _parts(options: Options, known: Known) -> list[Part]:
    seen = _megapixels_seen(options, known)
    if pick_backend(options.dense.backend) == "patchmatch":
        depth = Part("dense", "runs of PatchMatch", 3.0 * seen)
    else:
        depth = Part("dense", "depth maps", 2.7 * seen * _overlap(known) + 0.05 * known.registered)
    undistortion = 0.03 * known.registered_megapixels + 0.05 * known.registered
    return [
        Part("dense", "photographs laid flat", undistortion),
        depth,
        Part("dense", "fusions", 0.5 + 4e-6 * likely_points(options, known)),
    ]


STAGE = Stage(
    "dense",
    run,
    DenseRecord,
    sections=("dense",),
    libraries=("opencv", "numpy"),
    result_options=_result_options,
    switched_off=lambda options: "" if options.dense.enabled else "dense",
    files=_files,
    made=_made,
    remove=lambda project: shutil.rmtree(project.dense, ignore_errors=True),
    check=_check,
    needs=_needs,
    parts=_parts,
)
