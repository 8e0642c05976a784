"""Lay out the faces on the texture.

A chart is a patch of neighbouring faces with one label: as the photograph shows it, so that a texel is a pixel and
its colour that pixel's. Faces that no photograph shows are laid flat along an axis. xatlas packs the charts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Bool, Float64, Int32, Int64, PinholeCamera
from colmap_ihe.dense.texture.mesh import Mesh, components
from colmap_ihe.dense.texture.raster import areas
from colmap_ihe.errors import CapabilityError

_PADDING = 3  # texels between charts
_FILL = 0.6  # of the texture that charts take, at first guess
_UNSEEN_FACES_PER_TEXEL = 0.25


@dataclass(frozen=True)
class Patches:
    """Hold a mesh cut along the borders of labels.

    `vertex` (P,) is the row in the mesh of each corner of the cut mesh, `label` (P,) the label of the faces around
    it, `pixel` (P, 2) float64 its position on the photograph of that label; `faces` (F, 3) int32 are rows of
    corners, `patch` (F,) numbers the patches, `coloured` (F,) is false where no photograph colours a face.
    """

    vertex: Int64
    label: Int64
    pixel: Float64
    faces: Int32
    patch: Int64
    coloured: Bool


@dataclass(frozen=True)
class Atlas:
    """Hold the layout of a texture of `size` (width, height).

    `texel` (N, 2) float64, from the top left, is the position of the rows `source` (N,) of the cut mesh; `faces`
    (F, 3) int32 are rows of these; `scale` is texels per pixel of the photographs.
    """

    texel: Float64
    source: Int64
    faces: Int32
    size: tuple[int, int]
    scale: float


def cut(mesh: Mesh, labels: Int32, coloured: Bool, views: Sequence[PinholeCamera], pairs: Int64) -> Patches:
    """Cut a mesh along its `labels` (F,): rows of `views`, and above them sides of a box (see `select.choose`).

    `pairs` (E, 2) are neighbouring faces; `coloured` (F,) tells which faces have the colours of a photograph.
    """
    joined = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    patch = components(len(mesh.faces), joined)
    key = patch[:, None] * len(mesh.vertices) + mesh.faces
    unique, rows = np.unique(key, return_inverse=True)
    vertex = unique % max(len(mesh.vertices), 1)
    faces = rows.reshape(-1, 3).astype(np.int32)
    label = np.zeros(len(vertex), np.int64)
    label[faces] = labels[:, None]
    pixel = np.zeros((len(vertex), 2))
    for number, view in enumerate(views):
        members = label == number
        pixel[members] = view.project(mesh.vertices[vertex[members]])[0]
    density = _texels_per_unit(mesh)
    for side in range(6):
        members = label == len(views) + side
        pixel[members] = np.delete(mesh.vertices[vertex[members]], side % 3, axis=1) * density
    return Patches(vertex, label, pixel, faces, patch, coloured)


def _texels_per_unit(mesh: Mesh) -> float:
    """Return the density for faces that no photograph shows: a few texels a face, coloured by its corners."""
    area = np.linalg.norm(mesh.normals, axis=1).sum() / 2
    return float(np.sqrt(len(mesh.faces) / _UNSEEN_FACES_PER_TEXEL / max(area, 1e-30)))


def pack(patches: Patches, largest: int) -> Atlas:
    """Lay the patches side by side on a texture of sides up to `largest`, in the photographs' resolution if they fit.

    Raises `CapabilityError` where the patches are too many.
    """
    try:
        import xatlas  # here, for commands that make no texture
    except ModuleNotFoundError as error:
        raise CapabilityError(
            "xatlas is not installed, which the texture needs", hint="pip install xatlas, or use --no-mesh"
        ) from error

    corners = patches.pixel[patches.faces]
    area = float(areas(corners).sum())
    scale = min(1.0, largest * float(np.sqrt(_FILL / max(area, 1e-12))))
    # Small numbers near zero keep all digits of float32.
    origin = np.full((int(patches.patch.max(initial=0)) + 1, 2), np.inf)
    np.minimum.at(origin, np.repeat(patches.patch, 3), corners.reshape(-1, 2))
    shift = np.zeros_like(patches.pixel)
    shift[patches.faces] = origin[patches.patch][:, None]
    local = patches.pixel - shift
    for _ in range(6):
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh(
            (local * scale).astype(np.float32),
            patches.faces.astype(np.uint32),
            patches.patch.astype(np.uint32)[:, None],
        )
        options = xatlas.PackOptions()
        options.padding, options.bilinear, options.texels_per_unit = _PADDING, True, 1.0
        options.rotate_charts_to_axis = False
        atlas.generate(pack_options=options)
        size = (int(atlas.width), int(atlas.height))
        if max(size) <= largest:
            source, faces, uv = atlas.get_mesh(0)
            texel = np.asarray(uv, np.float64) * size
            return Atlas(texel, np.asarray(source, np.int64), np.asarray(faces, np.int32), size, scale)
        scale *= 0.97 * largest / max(size)
    raise CapabilityError(
        f"{len(origin)} patches do not fit on a texture of {largest} pixels",
        hint="raise mesh.texture_size, or lower mesh.faces",
    )
