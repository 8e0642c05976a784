"""A textured mesh from a mesh and the photographs of a COLMAP dense workspace: from paths to files."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import simplejpeg

from colmap_ihe.colmap.measures import upright
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.dense.texture.atlas import Atlas, cut, pack
from colmap_ihe.dense.texture.bake import bake, corner_colours
from colmap_ihe.dense.texture.level import seam_offsets
from colmap_ihe.dense.texture.mesh import F64, U8, Mesh, neighbours, vertex_normals
from colmap_ihe.dense.texture.raster import TextureView
from colmap_ihe.dense.texture.select import UNSEEN, Candidates, box_labels, choose, quality_in
from colmap_ihe.dense.undistort import read_colour, read_mask
from colmap_ihe.errors import CapabilityError
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import SILENT, Progress

FILES = ("mesh.glb", "mesh.obj", "mesh.mtl", "mesh.jpeg")
_JPEG_QUALITY = 95
_AHEAD = 2  # views under way more than there are workers


@dataclass(frozen=True)
class Texture:
    """What a texture holds, for the record. `texels_per_pixel` of the undistorted photographs."""

    width: int
    height: int
    patches: int
    faces_unseen: int
    texels_per_pixel: float
    views_used: int


def libraries() -> dict[str, ModuleType]:
    """xatlas and trimesh by name. Raises `CapabilityError`."""
    try:
        return {name: importlib.import_module(name) for name in ("xatlas", "trimesh")}
    except ImportError as error:
        raise CapabilityError(
            f"a textured mesh needs xatlas and trimesh: {error}",
            hint="pip install 'colmap-ihe[mesh]', or set mesh.texture to auto or false",
        ) from error


def is_possible() -> bool:
    """Whether the libraries are there."""
    try:
        libraries()
    except CapabilityError:
        return False
    return True


def texture_mesh(
    dense_dir: Path, mesh_file: Path, largest: int, *, executor: Executor, progress: Progress = SILENT
) -> Texture:
    """Writes `FILES` beside `mesh_file`, textured from `dense_dir/images`, on one texture of sides up to `largest`.

    Raises `CapabilityError` without the libraries, `ProjectError` where a photograph cannot be read, `Cancelled`.
    """
    libraries()
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: str(image.name))
    paths = [dense_dir / "images" / image.name for image in images]
    views = [_view(model, image) for image in images]
    mesh = read_mesh(mesh_file)
    masks = [partial(read_mask, dense_dir, image.name) for image in images]
    candidates = _candidates(mesh, views, masks, executor, progress)
    progress.start(1, "atlases")
    pairs = neighbours(mesh.faces)
    chosen = choose(candidates, pairs)
    labels = box_labels(mesh, chosen, len(views))
    patches = cut(mesh, labels, views, pairs)
    atlas = pack(patches, largest)
    progress.advance()
    progress.start(len(views), "photographs compared at seams")
    colours, known = corner_colours(patches, labels, _pictures(paths, progress), mesh.colours)
    progress.start(1, "seams")
    offsets = seam_offsets(patches, colours, known)
    progress.advance()
    progress.start(len(views), "photographs on the texture")
    texture = bake(atlas, patches, labels, _pictures(paths, progress), offsets, mesh.colours)
    progress.start(1, "sets of files")
    _write(mesh_file.parent, mesh, atlas, patches.vertex[atlas.source], texture, _upright(views))
    progress.advance()
    return Texture(
        *atlas.size,
        patches=int(patches.patch.max(initial=-1)) + 1,
        faces_unseen=int((chosen == UNSEEN).sum()),
        texels_per_pixel=round(atlas.scale, 3),
        views_used=len(np.unique(chosen[chosen != UNSEEN])),
    )


def _candidates(
    mesh: Mesh,
    views: list[TextureView],
    masks: Sequence[Callable[[], U8 | None]],
    executor: Executor,
    progress: Progress,
) -> Candidates:
    """The best views of each face; added in the order of the views, so that the result is always the same."""
    candidates = Candidates.none(len(mesh.faces))
    progress.start(len(views), "photographs looked through")
    jobs = []
    try:
        for number, view in enumerate(views):
            jobs.append((number, executor.submit(quality_in, mesh, view, masks[number])))
            if len(jobs) > _AHEAD:
                first, job = jobs.pop(0)
                candidates.add(first, job.result())
                progress.advance()
        for number, job in jobs:
            candidates.add(number, job.result())
            progress.advance()
    finally:
        for _, job in jobs:
            job.cancel()
    return candidates


def _view(model: pycolmap.Reconstruction, image: pycolmap.Image) -> TextureView:
    camera = model.cameras[image.camera_id]
    return TextureView(
        camera.calibration_matrix(), image.cam_from_world().matrix(), (camera.width, camera.height)
    )


def _pictures(paths: list[Path], progress: Progress) -> Iterator[U8]:
    for path in paths:
        yield read_colour(path)
        progress.advance()


def _upright(views: list[TextureView]) -> F64:
    """(4, 4): turns the mean upward direction of the photographs to +y, which is up in glTF."""
    turned = np.eye(4)
    turned[:3, :3] = upright([view.cam_from_world for view in views])
    return turned


class _Coded:
    """What trimesh asks of a picture, which it would else compress anew: bytes that are JPEG already."""

    format, mode = "JPEG", "RGB"

    def __init__(self, content: bytes, size: tuple[int, int]) -> None:
        self.content, self.size = content, size

    def save(self, fp: Any, format: str | None = None) -> None:
        fp.write(self.content)


def _write(folder: Path, mesh: Mesh, atlas: Atlas, vertex: Any, texture: U8, upright: F64) -> None:
    """`vertex` (N,) is the row in the mesh of each row of the atlas."""
    trimesh: Any = libraries()["trimesh"]
    jpeg = simplejpeg.encode_jpeg(texture, quality=_JPEG_QUALITY, colorspace="RGB", colorsubsampling="444")
    uv = atlas.texel / atlas.size
    uv[:, 1] = 1 - uv[:, 1]  # trimesh's texture begins at the bottom
    material = trimesh.visual.material.PBRMaterial(
        name="photographs",
        baseColorTexture=_Coded(jpeg, atlas.size),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    made = trimesh.Trimesh(
        mesh.vertices[vertex],
        atlas.faces,
        vertex_normals=vertex_normals(mesh)[vertex],
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
        process=False,
    )
    scene = trimesh.Scene()
    scene.add_geometry(made, node_name="mesh", geom_name="mesh", transform=upright)
    write_bytes(folder / "mesh.glb", scene.export(file_type="glb", include_normals=True))
    white = [255, 255, 255, 255]
    plain = trimesh.visual.material.SimpleMaterial(
        name="mesh", image=_Coded(jpeg, atlas.size), ambient=white, diffuse=white, specular=[0, 0, 0, 255]
    )
    made.visual = trimesh.visual.TextureVisuals(uv=uv, material=plain)
    text, files = trimesh.exchange.obj.export_obj(
        made, include_normals=False, return_texture=True, mtl_name="mesh.mtl", header=None
    )
    for name, content in files.items():
        write_bytes(folder / name, content)
    write_bytes(folder / "mesh.obj", text.encode())
