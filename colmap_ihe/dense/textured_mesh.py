"""Texture a mesh from the photographs of a COLMAP dense workspace, from paths to files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg

from colmap_ihe.colmap.measures import upright
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Float32, Float64, PinholeCamera, UInt8
from colmap_ihe.dense.depth_maps import camera_of
from colmap_ihe.dense.obj import mtl_text, obj_text
from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.dense.texture.agree import agreed_colours, at_corners, centre_colours, doubted
from colmap_ihe.dense.texture.atlas import Atlas, Patches, cut, pack
from colmap_ihe.dense.texture.bake import bake, corner_colours, paint
from colmap_ihe.dense.texture.exposure import exposure_tables, with_table
from colmap_ihe.dense.texture.level import seam_offsets
from colmap_ihe.dense.texture.mesh import Mesh, neighbours, vertex_normals
from colmap_ihe.dense.texture.seams import seam_points
from colmap_ihe.dense.texture.select import Candidates, choose, quality_in
from colmap_ihe.dense.undistort import read_colour, read_mask
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import SILENT, Progress

FILES = ("mesh.glb", "mesh.obj", "mesh.mtl", "mesh.jpeg")
_JPEG_QUALITY = 97
_FACES_AT_ONCE = 30_000
_UNLIT = "KHR_materials_unlit"


@dataclass(frozen=True)
class Texture:
    """Describe a texture, for the record; `texels_per_pixel` of the undistorted photographs."""

    width: int
    height: int
    patches: int
    faces_unseen: int
    texels_per_pixel: float
    views_used: int


def texture_mesh(
    dense_dir: Path,
    mesh_file: Path,
    largest: int,
    *,
    z_is_up: bool = False,
    executor: Executor,
    progress: Progress = SILENT,
) -> Texture:
    """Write `FILES` beside `mesh_file`, textured from `dense_dir/images`, on one texture of sides up to `largest`.
    Up is z where `z_is_up`, else as the photographs were held.

    Raises `CapabilityError` where the texture is too small, `ProjectError` where a photograph cannot be read,
    `Cancelled`.
    """
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: str(image.name))
    paths = [dense_dir / "images" / image.name for image in images]
    views = [camera_of(model, image.image_id) for image in images]
    mesh = read_mesh(mesh_file)

    masks = [partial(read_mask, dense_dir, image.name) for image in images]
    candidates = _looked_through(mesh, views, masks, paths, executor, progress)
    tables = exposure_tables(candidates.view, candidates.colour, len(views))
    agreed = _agreed(candidates, tables, executor, progress)
    executor.submit(import_module, "trimesh")  # for the files, while the atlas is made
    progress.start(1, "atlases")
    pairs = neighbours(mesh.faces)
    labels, coloured = choose(candidates, mesh, pairs, views)
    patches = cut(mesh, labels, coloured, views, pairs)
    atlas = pack(patches, largest)
    points = seam_points(patches, atlas)
    progress.advance()
    progress.start(len(views), "photographs compared at seams")
    colours, seen = corner_colours(patches, _pictures(paths, tables, executor, progress), mesh.colours)
    agreed_there = at_corners(patches.faces, len(colours), agreed)
    levelled = executor.submit(seam_offsets, patches, colours, seen, agreed_there)  # while texels are painted
    progress.start(len(views), "photographs on the texture")
    painted = paint(atlas, patches, _pictures(paths, tables, executor, progress), colours)
    progress.start(1, "seams")
    offsets = levelled.result()
    written = executor.submit(
        _write_obj, mesh_file.parent, mesh, atlas, patches
    )  # while the texture is baked
    texture = bake(atlas, patches, painted, offsets, points)
    progress.advance()
    progress.start(1, "sets of files")
    up = np.array((0.0, 0.0, 1.0)) if z_is_up else None
    turn = upright([view.cam_from_world for view in views], up)
    _write_glb(mesh_file.parent, mesh, atlas, patches, texture, turn)
    written.result()
    progress.advance()
    return Texture(
        *atlas.size,
        patches=int(patches.patch.max(initial=-1)) + 1,
        faces_unseen=int((~coloured).sum()),
        texels_per_pixel=round(atlas.scale, 3),
        views_used=len(np.unique(labels[coloured])),
    )


def _looked_through(
    mesh: Mesh,
    views: Sequence[PinholeCamera],
    masks: Sequence[Callable[[], UInt8 | None]],
    paths: Sequence[Path],
    executor: Executor,
    progress: Progress,
) -> Candidates:
    """Return how well each photograph shows the faces, and in which colour."""

    def look(number: int) -> tuple[Float32, UInt8]:
        quality = quality_in(mesh, views[number], masks[number])
        return quality, centre_colours(mesh, views[number], read_colour(paths[number]))

    progress.start(len(views), "photographs looked through")
    candidates = Candidates.none(len(mesh.faces))
    at_once = 3  # photographs, each with values for all faces
    looks = in_order(executor, look, range(len(views)), at_once, progress)
    for number, (quality, colour) in enumerate(looks):
        candidates.add(number, quality, colour)
        progress.advance()
    return candidates


def _agreed(candidates: Candidates, tables: UInt8, executor: Executor, progress: Progress) -> Float32:
    """Return (F, 3), the colours that photographs agree on, once they are made alike by `tables`; make the quality
    negative where one is far from them. Some faces at a time."""

    def judge(faces: slice) -> tuple[slice, Float32, Float32]:
        view, quality = candidates.view[faces], candidates.quality[faces]
        colour = tables[np.maximum(view, 0)[..., None], candidates.colour[faces], np.arange(3)]
        quality = doubted(quality, colour)
        return faces, quality, agreed_colours(quality, colour)

    agreed = np.empty((len(candidates.view), 3), np.float32)
    parts = [slice(start, start + _FACES_AT_ONCE) for start in range(0, len(agreed), _FACES_AT_ONCE)]
    for faces, quality, colours in in_order(executor, judge, parts, progress=progress):
        candidates.quality[faces], agreed[faces] = quality, colours
    return agreed


def _pictures(paths: list[Path], tables: UInt8, executor: Executor, progress: Progress) -> Iterator[UInt8]:
    """Yield the photographs, made alike, of which the next is read meanwhile."""

    def read(number: int) -> UInt8:
        return with_table(read_colour(paths[number]), tables[number])

    for picture in in_order(executor, read, range(len(paths)), at_once=2, progress=progress):
        yield picture
        progress.advance()


class _Coded:
    """Stand for a picture in trimesh, which would compress it anew: hold bytes that are JPEG already."""

    format, mode = "JPEG", "RGB"

    def __init__(self, content: bytes, size: tuple[int, int]) -> None:
        self.content, self.size = content, size

    def save(self, fp: Any, format: str | None = None) -> None:
        """Write the bytes to a file that is open."""
        fp.write(self.content)


def _unlit(tree: dict[str, Any]) -> None:
    """Say in a glTF tree that its materials are not to be lit: light and shade are in the photographs already."""
    tree["extensionsUsed"] = sorted({*tree.get("extensionsUsed", ()), _UNLIT})
    for material in tree["materials"]:
        material.setdefault("extensions", {})[_UNLIT] = {}


def _uv(atlas: Atlas) -> Float64:
    """Return (N, 2), the places of the rows of an atlas on the texture, from its bottom left, as shares of its size."""
    return np.asarray((0, 1) - atlas.texel / atlas.size * (-1, 1))


def _write_obj(folder: Path, mesh: Mesh, atlas: Atlas, patches: Patches) -> None:
    """Write the OBJ file and the MTL file that it names."""
    write_bytes(folder / "mesh.mtl", mtl_text("mesh", "mesh.jpeg").encode())
    vertices = mesh.vertices[patches.vertex[atlas.source]]
    write_bytes(folder / "mesh.obj", obj_text(vertices, _uv(atlas), atlas.faces, "mesh", "mesh.mtl").encode())


def _write_glb(
    folder: Path, mesh: Mesh, atlas: Atlas, patches: Patches, texture: UInt8, turn: Float64
) -> None:
    """Write the texture, and the GLB file with it. `turn` (3, 3) turns the mean upward direction of the photographs to
    +y, which is up in glTF."""
    import trimesh  # here, for commands that make no texture

    jpeg = simplejpeg.encode_jpeg(texture, quality=_JPEG_QUALITY, colorspace="RGB", colorsubsampling="444")
    vertex = patches.vertex[atlas.source]
    material = trimesh.visual.material.PBRMaterial(
        name="photographs",
        baseColorTexture=_Coded(jpeg, atlas.size),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    surface = trimesh.Trimesh(
        mesh.vertices[vertex],
        atlas.faces,
        vertex_normals=vertex_normals(mesh)[vertex],
        visual=trimesh.visual.TextureVisuals(uv=_uv(atlas), material=material),
        process=False,
    )
    scene = trimesh.Scene()
    node_transform = np.eye(4)
    node_transform[:3, :3] = turn
    scene.add_geometry(surface, node_name="mesh", geom_name="mesh", transform=node_transform)
    write_bytes(
        folder / "mesh.glb", scene.export(file_type="glb", include_normals=True, tree_postprocessor=_unlit)
    )
    write_bytes(folder / "mesh.jpeg", jpeg)
