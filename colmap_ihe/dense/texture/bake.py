"""The texture itself: each texel from the photograph of its face, levelled, and gutters filled."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.texture.atlas import Atlas, Patches
from colmap_ihe.dense.texture.mesh import F32, F64, I32, U8, Bool
from colmap_ihe.dense.texture.raster import covered

_SEAM_BLUR_PX = 1.5  # of the colours compared across seams: photographs are not aligned to less than a pixel
_REMAP_ROW = 1024


@dataclass(frozen=True)
class Texels:
    """Those that charts cover: `pixel` (N,) row-major in the texture, `face` (N,) and barycentric `weights` (N, 3)
    in the atlas's faces."""

    pixel: I32
    face: I32
    weights: F32


def texels_of(atlas: Atlas) -> Texels:
    """Each texel once; where charts overlap, the last face has it. A face that covers the centre of no texel has
    the one that it lies in, else its colour would be its neighbour's on the texture."""
    face = np.full(atlas.size[0] * atlas.size[1], -1, np.int32)
    weights = np.zeros((len(face), 3), np.float32)
    corners = atlas.texel[atlas.faces]
    for part in covered(corners, atlas.size):
        face[part.pixel] = part.face
        weights[part.pixel] = part.weights
    small = np.setdiff1d(np.arange(len(corners)), face)
    column, row = np.clip(np.floor(corners[small].mean(axis=1)).T, 0, np.array([atlas.size]).T - 1)
    there = (row * atlas.size[0] + column).astype(np.int64)
    free = face[there] < 0
    face[there[free]] = small[free]
    weights[there[free]] = 1 / 3
    pixel = np.flatnonzero(face >= 0)
    return Texels(pixel.astype(np.int32), face[pixel], weights[pixel])


def sample(picture: U8, pixels: F64, scale: float = 1.0) -> F32:
    """(N, 3) float32 of a picture (H, W, 3) at (N, 2) pixels, bilinear; the centre of the top left pixel is
    (0.5, 0.5). Where `scale`, of texels per pixel, is well below one, from a picture of that scale."""
    if scale < 0.75:
        height, width = picture.shape[:2]
        size = max(1, round(width * scale)), max(1, round(height * scale))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        pixels = pixels * (size[0] / width, size[1] / height)
    count = len(pixels)
    rows = -(-count // _REMAP_ROW)
    places = np.zeros((rows * _REMAP_ROW, 2), np.float32)
    places[:count] = pixels - 0.5
    shaped = places.reshape(rows, _REMAP_ROW, 2)
    found = np.empty((rows, _REMAP_ROW, 3), np.float32)
    real = picture.astype(np.float32)
    for top in range(0, rows, 16_384):  # OpenCV's limit of rows
        part = shaped[top : top + 16_384]
        found[top : top + 16_384] = cv2.remap(
            real, part[..., 0], part[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return found.reshape(-1, 3)[:count]


def corner_colours(
    patches: Patches, labels: I32, pictures: Iterable[U8], vertex_colours: U8
) -> tuple[F64, Bool]:
    """What its photograph shows at each corner of the cut mesh, (P, 3) float64, and whether one does, (P,)."""
    label = corner_labels(patches, labels)
    colours = vertex_colours[patches.vertex].astype(np.float64)
    known = np.zeros(len(label), bool)
    for number, picture in enumerate(pictures):
        here = label == number
        blurred = cv2.GaussianBlur(picture, (0, 0), _SEAM_BLUR_PX)
        colours[here] = sample(np.asarray(blurred, np.uint8), patches.place[here])
        known |= here
    return colours, known


def corner_labels(patches: Patches, labels: I32) -> I32:
    """(P,): the label of the faces around each corner of the cut mesh, which is the same for all."""
    label = np.full(len(patches.vertex), -1, np.int32)
    label[patches.faces] = labels[:, None]
    return label


def bake(
    atlas: Atlas,
    patches: Patches,
    labels: I32,
    pictures: Iterable[U8],
    offsets: F64,
    vertex_colours: U8,
) -> U8:
    """The texture, (height, width, 3) uint8 RGB. `labels` (F,) are numbers of `pictures`, or above them where no
    photograph shows a face: there it has `vertex_colours`. `offsets` (P, 3) are added to the corners' colours."""
    texels = texels_of(atlas)
    corners = atlas.source[atlas.faces][texels.face]
    label = labels[texels.face]
    weights = texels.weights[:, :, None]
    colours = (vertex_colours[patches.vertex].astype(np.float32)[corners] * weights).sum(axis=1)
    for number, picture in enumerate(pictures):
        here = np.flatnonzero(label == number)
        if len(here):
            place = (patches.place[corners[here]] * weights[here]).sum(axis=1)
            colours[here] = sample(picture, place, atlas.scale)
    colours += (offsets.astype(np.float32)[corners] * weights).sum(axis=1)
    texture = np.zeros((atlas.size[1] * atlas.size[0], 3), np.uint8)
    texture[texels.pixel] = np.clip(np.rint(colours), 0, 255)
    filled = np.zeros(len(texture), bool)
    filled[texels.pixel] = True
    return _with_gutters(texture.reshape(atlas.size[1], atlas.size[0], 3), filled.reshape(atlas.size[::-1]))


def _with_gutters(texture: U8, filled: Bool) -> U8:
    """Texels between charts have the colour of the nearest chart, so that smaller copies of the texture, which
    viewers make, mix in nothing else."""
    if not filled.any():
        return texture
    _, nearest = cv2.distanceTransformWithLabels(
        (~filled).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    by_label = np.zeros((int(nearest.max()) + 1, 3), np.uint8)
    by_label[nearest[filled]] = texture[filled]
    return np.asarray(by_label[nearest], np.uint8)
