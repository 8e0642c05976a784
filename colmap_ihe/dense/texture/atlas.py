"""Where on the texture each face lies.

A chart is a patch of neighbouring faces with one label: as the photograph shows it, so that a texel is a pixel and
its colour that pixel's. Faces that no photograph shows are laid flat along an axis. xatlas packs the charts.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.texture.mesh import F64, I32, I64, Mesh, components, face_normals
from colmap_ihe.dense.texture.raster import TextureView
from colmap_ihe.errors import CapabilityError

_PADDING = 3  # texels between charts
_FILL = 0.6  # of the texture that charts take, at first guess
_UNSEEN_FACES_PER_TEXEL = 0.25


@dataclass(frozen=True)
class Patches:
    """A mesh cut along the borders of labels: `vertex` (P,) is the row in the mesh of each corner of the cut one,
    `faces` (F, 3) int32 are in its rows, `patch` (F,) numbers the patches, `place` (P, 2) float64 is where each
    lies on the photograph of its label, in pixels."""

    vertex: I64
    faces: I32
    patch: I64
    place: F64


@dataclass(frozen=True)
class Atlas:
    """`texel` (N, 2) float64 from the top left of a texture of `size` (width, height), of the rows `source` (N,)
    of the cut mesh; `faces` (F, 3) int32 are in rows of these; `scale` is texels per pixel of the photographs."""

    texel: F64
    source: I64
    faces: I32
    size: tuple[int, int]
    scale: float


def cut(mesh: Mesh, labels: I32, views: Sequence[TextureView], pairs: I64) -> Patches:
    """`labels` (F,) are rows of `views`, and behind them the sides of a box (see `select.box_labels`)."""
    joined = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    patch = components(len(mesh.faces), joined)
    key = patch[:, None] * len(mesh.vertices) + mesh.faces
    unique, rows = np.unique(key, return_inverse=True)
    vertex = unique % max(len(mesh.vertices), 1)
    faces = rows.reshape(-1, 3).astype(np.int32)
    label = np.zeros(len(vertex), np.int64)
    label[faces] = labels[:, None]
    place = np.zeros((len(vertex), 2))
    for number, view in enumerate(views):
        here = label == number
        place[here] = view.project(mesh.vertices[vertex[here]])[0]
    density = _texels_per_unit(mesh)
    for side in range(6):
        here = label == len(views) + side
        place[here] = np.delete(mesh.vertices[vertex[here]], side % 3, axis=1) * density
    return Patches(vertex, faces, patch, place)


def _texels_per_unit(mesh: Mesh) -> float:
    """For faces that no photograph shows: a few texels a face, whose colours are those of its corners."""
    area = np.linalg.norm(face_normals(mesh.corners()), axis=1).sum() / 2
    return float(np.sqrt(len(mesh.faces) / _UNSEEN_FACES_PER_TEXEL / max(area, 1e-30)))


def pack(patches: Patches, largest: int) -> Atlas:
    """Lays the patches side by side on a texture of sides up to `largest`, in the photographs' resolution where
    that has room. Raises `CapabilityError` where the patches are too many, ImportError without xatlas."""
    xatlas = importlib.import_module("xatlas")
    corners = patches.place[patches.faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = float(np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum() / 2)
    scale = min(1.0, largest * float(np.sqrt(_FILL / max(area, 1e-12))))
    # Small numbers near zero keep all digits of float32.
    origin = np.full((int(patches.patch.max(initial=0)) + 1, 2), np.inf)
    np.minimum.at(origin, np.repeat(patches.patch, 3), corners.reshape(-1, 2))
    shift = np.zeros_like(patches.place)
    shift[patches.faces] = origin[patches.patch][:, None]
    local = patches.place - shift
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
        f"{int(patches.patch.max()) + 1} patches have no room on a texture of {largest} pixels",
        hint="raise mesh.texture_size, or lower mesh.faces",
    )
