"""Make a mesh of the dense cloud, with vertex colours and with a texture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from colmap_ihe.dense import mesh, textured_mesh
from colmap_ihe.dense.depth_maps import depth_maps
from colmap_ihe.dense.refined import SIMPLIFIED, refine_surface
from colmap_ihe.errors import MappingError
from colmap_ihe.machine.executor import threads_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.machine.threads import one_blas_thread
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Count, FileName, Record, RunContext, Stage, StageRecord, StrictModel
from colmap_ihe.pipeline.stages.dense import POINTS_A_PIXEL, likely_points, pixels_seen
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_POINT, _FACE = 200, 4_500  # bytes of memory, a point of the cloud and a face
_FACE_ON_DISK = 180  # bytes in all files of the mesh


class _TextureRecord(StrictModel):
    width: Count
    height: Count


class MeshRecord(StageRecord):
    """Name the files of the mesh; count its faces; the share of its vertices that depth maps moved; the size of the
    texture in pixels."""

    files: list[FileName]
    faces: Count | None = None
    vertices_moved_percent: float | None = None
    texture: _TextureRecord | None = None


def run(run: RunContext, progress: Progress) -> MeshRecord:
    """Make the mesh, or say why there is none: the cloud is there all the same."""
    project, options = run.project, run.options.mesh
    try:
        with one_blas_thread():
            surface = mesh.reconstruct_surface(
                project.dense / "fused.ply",
                project.mesh,
                options.faces,
                options=options.colmap,
                progress=progress,
                dense_dir=project.dense,
                simplified=SIMPLIFIED if depth_maps(project.dense) else 1.0,
            )
            refined = refine_surface(project.mesh, project.dense, options.faces, progress)
    except MappingError as error:
        return MeshRecord(files=[], warnings=[f"no mesh was made: {error}"])
    made = {
        **asdict(surface),
        "faces": refined.faces,
        "vertices_moved_percent": round(refined.moved_percent, 1),
    }
    if options.texture is False:
        return MeshRecord(**made, files=[project.mesh.name], warnings=[])
    with threads_of(run.executor) as threads:  # each looks at all of the mesh
        texture = textured_mesh.texture_mesh(
            project.dense,
            project.mesh,
            options.texture_size,
            z_is_up=run.is_metric,
            executor=threads,
            progress=progress,
        )
    files = [project.mesh.name, *textured_mesh.FILES]
    return MeshRecord(**made, texture=_TextureRecord(**asdict(texture)), files=files, warnings=[])


def _result_options(options: Options) -> dict[str, Any]:
    values = options.sections("mesh")
    del values["mesh"]["enabled"]
    values["mesh"]["texture"] = options.mesh.texture is not False
    return values


def _switched_off(options: Options) -> str:
    return next((name for name in ("dense", "mesh") if not getattr(options, name).enabled), "")


def _files(project: Project, record: Record) -> list[Path]:
    return [project.dense / name for name in record["files"]]


def _check(options: Options, images: int) -> None:
    if options.meshed:
        mesh.poisson_options(options.mesh.colmap)


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    points = POINTS_A_PIXEL * pixels_seen(options, size)
    faces = min(options.mesh.faces, 1.5 * points)
    memory = BASE_BYTES + round(_POINT * points + _FACE * faces)
    return StageNeeds("mesh", memory, 0, round(faces * _FACE_ON_DISK), saves="fewer mesh.faces")


def _parts(options: Options, known: Known) -> list[Part]:
    images, megapixels, points = known.registered, known.registered_megapixels, likely_points(options, known)
    surface = [
        Part("mesh", "parts of the surface", 7.0 + 1.05e-5 * points),
        Part("mesh", "depth maps compared with the surface", 0.1 * images),
        Part("mesh", "depth maps compared with the surface", 0.1 * images),  # once more where it bends
    ]
    if options.mesh.texture is False:
        return surface
    return [
        *surface,
        Part("mesh", "photographs looked through", 0.13 * megapixels + 0.04 * images),
        Part("mesh", "atlases", 0.7 + 8.4e-7 * points),
        Part("mesh", "photographs compared at seams", 0.02 * megapixels + 0.014 * images),
        Part("mesh", "photographs on the texture", 0.04 * megapixels + 0.03 * images),
        Part("mesh", "seams", 1.5 + 3e-6 * points),
        Part("mesh", "sets of files", 1.4),
    ]


STAGE = Stage(
    "mesh",
    run,
    MeshRecord,
    sections=("mesh",),
    result_options=_result_options,
    switched_off=_switched_off,
    files=_files,
    made=lambda project: sorted(project.dense.glob("mesh.*")),
    check=_check,
    needs=_needs,
    parts=_parts,
)
