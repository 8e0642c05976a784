"""Choose the photographs that colour a mesh, from a COLMAP dense workspace and the photographs in full size."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.field_of_view import pixels_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Float32, Float64, PinholeCamera, UInt8
from colmap_ihe.dense.depth_maps import camera_of
from colmap_ihe.dense.texture.agree import agreed_colours, at_corners, centre_colours, doubted
from colmap_ihe.dense.texture.atlas import cut
from colmap_ihe.dense.texture.bake import corner_colours
from colmap_ihe.dense.texture.level import seam_offsets
from colmap_ihe.dense.texture.mesh import Mesh, neighbours
from colmap_ihe.dense.texture.select import Candidates, choose, quality_in
from colmap_ihe.dense.undistort import read_colour, read_mask
from colmap_ihe.drawings.colours import PaintedSurface, Photograph
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import SILENT, Progress

_AT_ONCE = 3  # photographs, each with values for all faces


@dataclass(frozen=True)
class Source:
    """Hold an undistorted picture of a photograph: its `camera`; `read`, which returns it as (H, W, 3) uint8 RGB; and
    `mask`, which returns (H, W) uint8, 0 where it must not be used, or None."""

    camera: PinholeCamera
    read: Callable[[], UInt8]
    mask: Callable[[], UInt8 | None]


def painted_surface(
    mesh: Mesh,
    dense_dir: Path,
    model_dir: Path,
    colour_dir: Path,
    executor: Executor,
    progress: Progress = SILENT,
) -> PaintedSurface:
    """Return a mesh with the photographs that show its faces best. They are chosen, and their colours levelled, on the
    undistorted images of `dense_dir`; colours come from `colour_dir`, in full size, by the cameras of `model_dir`.
    Raises `ProjectError` where a photograph cannot be read, `Cancelled`."""
    flat = pycolmap.Reconstruction(dense_dir / "sparse")
    images = sorted((flat.images[i] for i in flat.reg_image_ids()), key=lambda image: str(image.name))
    names = [str(image.name) for image in images]
    sources = [
        Source(
            camera_of(flat, image.image_id),
            partial(read_colour, dense_dir / "images" / str(image.name)),
            partial(read_mask, dense_dir, str(image.name)),
        )
        for image in images
    ]
    return paint_mesh(mesh, sources, full_photographs(model_dir, colour_dir, names), executor, progress)


def paint_mesh(
    mesh: Mesh,
    sources: Sequence[Source],
    photographs: Sequence[Photograph],
    executor: Executor,
    progress: Progress = SILENT,
) -> PaintedSurface:
    """Return a mesh with the `sources` that show its faces best, each an undistorted picture of the photograph of the
    same row. Raises `Cancelled`, and what the sources raise."""
    views = [source.camera for source in sources]

    def look(number: int) -> tuple[Float32, UInt8]:
        quality = quality_in(mesh, views[number], sources[number].mask)
        return quality, centre_colours(mesh, views[number], sources[number].read())

    progress.start(len(views), "photographs looked through")
    candidates = Candidates.none(len(mesh.faces))
    for number, (quality, colour) in enumerate(
        in_order(executor, look, range(len(views)), _AT_ONCE, progress)
    ):
        candidates.add(number, quality, colour)
        progress.advance()
    candidates.quality = doubted(candidates.quality, candidates.colour)
    agreed = agreed_colours(candidates.quality, candidates.colour)
    pairs = neighbours(mesh.faces)
    labels, coloured = choose(candidates, mesh, pairs, views)
    patches = cut(mesh, labels, coloured, views, pairs)
    progress.start(len(views), "photographs compared at seams")
    colours, seen = corner_colours(patches, _pictures(sources, progress), mesh.colours)
    offsets = seam_offsets(patches, colours, seen, at_corners(patches.faces, len(colours), agreed))
    return PaintedSurface(patches, photographs, offsets.astype(np.float32), colours.astype(np.float32))


def _pictures(sources: Sequence[Source], progress: Progress) -> Iterator[UInt8]:
    for source in sources:
        yield source.read()
        progress.advance()


def full_photographs(model_dir: Path, colour_dir: Path, names: list[str]) -> list[Photograph]:
    """Return photographs in full size, as distorted as they are, with the cameras of a model."""
    model = pycolmap.Reconstruction(model_dir)
    images = {str(model.images[i].name): model.images[i] for i in model.reg_image_ids()}
    photographs = []
    for name in names:
        image = images[name]
        camera = model.cameras[image.camera_id]
        photographs.append(
            Photograph(
                name,
                partial(read_colour, colour_dir / name),
                _projection(camera, np.asarray(image.cam_from_world().matrix())),
                float(camera.mean_focal_length()),
            )
        )
    return photographs


def _projection(
    camera: pycolmap.Camera, cam_from_world: Float64
) -> Callable[[Float64], tuple[Float64, Float64]]:
    def project(points: Float64) -> tuple[Float64, Float64]:
        in_camera = points @ cam_from_world[:, :3].T + cam_from_world[:, 3]
        return pixels_of(camera, in_camera), np.asarray(in_camera[:, 2])

    return project
