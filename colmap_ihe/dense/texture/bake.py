"""Paint the texture: each texel from the photograph of its face, levelled, with gutters filled."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, UInt8
from colmap_ihe.dense.texture.atlas import Atlas, Patches
from colmap_ihe.dense.texture.raster import Covered, covered

_SEAM_BLUR_PX = 1.5  # of the colours compared across seams: photographs are not aligned to less than a pixel
_REMAP_ROW = 1024
_REMAP_ROWS = 16_384  # OpenCV takes no more than 32,766


def texels_of(atlas: Atlas) -> Covered:
    """Return each texel that a chart covers once, with a face of the atlas; where charts overlap, the last face.

    A face that covers the centre of no texel gets the one that it lies in, else its colour would be its neighbour's.
    """
    face = np.full(atlas.size[0] * atlas.size[1], -1, np.int32)
    weights = np.zeros((len(face), 3), np.float32)
    corners = atlas.texel[atlas.faces]
    for part in covered(corners, atlas.size):
        face[part.pixel] = part.face
        weights[part.pixel] = part.weights
    small = np.setdiff1d(np.arange(len(corners)), face)
    column, row = np.clip(np.floor(corners[small].mean(axis=1)).T, 0, np.array([atlas.size]).T - 1)
    texel = (row * atlas.size[0] + column).astype(np.int64)
    free = face[texel] < 0
    face[texel[free]] = small[free]
    weights[texel[free]] = 1 / 3
    pixel = np.flatnonzero(face >= 0)
    return Covered(pixel.astype(np.int32), face[pixel], weights[pixel])


def sample(picture: UInt8, pixels: Float64, scale: float = 1.0) -> Float32:
    """Return the colours (N, 3) float32 of a picture (H, W, 3) at `pixels` (N, 2), bilinear.

    Where `scale`, of texels per pixel, is well below one, they come from a picture of that scale.
    """
    if scale < 0.75:
        height, width = picture.shape[:2]
        size = max(1, round(width * scale)), max(1, round(height * scale))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        pixels = pixels * (size[0] / width, size[1] / height)
    count = len(pixels)
    rows = -(-count // _REMAP_ROW)
    positions = np.zeros((rows, _REMAP_ROW, 2), np.float32)
    positions.reshape(-1, 2)[:count] = pixels - 0.5
    colours = np.empty((rows, _REMAP_ROW, 3), np.float32)
    source = picture.astype(np.float32)
    for top in range(0, rows, _REMAP_ROWS):
        x, y = np.moveaxis(positions[top : top + _REMAP_ROWS], 2, 0)
        colours[top : top + _REMAP_ROWS] = cv2.remap(
            source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return colours.reshape(-1, 3)[:count]


def corner_colours(
    patches: Patches, pictures: Iterable[UInt8], vertex_colours: UInt8
) -> tuple[Float64, Bool]:
    """Return the colours (P, 3) float64 of each corner of the cut mesh in its photograph, and (P,), true where one
    shows it; else it has its vertex colour."""
    colours = vertex_colours[patches.vertex].astype(np.float64)
    seen = np.zeros(len(colours), bool)
    for number, picture in enumerate(pictures):
        members = patches.label == number
        blurred = cv2.GaussianBlur(picture, (0, 0), _SEAM_BLUR_PX)
        colours[members] = sample(np.asarray(blurred, np.uint8), patches.pixel[members])
        seen |= members
    return colours, seen


def bake(
    atlas: Atlas, patches: Patches, pictures: Iterable[UInt8], offsets: Float64, vertex_colours: UInt8
) -> UInt8:
    """Return the texture, (height, width, 3) uint8 RGB, gamma-coded as the pictures.

    Labels of `patches` are numbers of `pictures`, or above them where no photograph shows a face: there it has
    `vertex_colours`. `offsets` (P, 3) are added to the corners' colours.
    """
    texels = texels_of(atlas)
    corners = atlas.source[atlas.faces][texels.face]
    label = patches.label[corners[:, 0]]
    weights = texels.weights[:, :, None]
    colours = (vertex_colours[patches.vertex].astype(np.float32)[corners] * weights).sum(axis=1)
    for number, picture in enumerate(pictures):
        rows = np.flatnonzero(label == number)
        if len(rows):
            pixels = (patches.pixel[corners[rows]] * weights[rows]).sum(axis=1)
            colours[rows] = sample(picture, pixels, atlas.scale)
    colours += (offsets.astype(np.float32)[corners] * weights).sum(axis=1)
    width, height = atlas.size
    texture = np.zeros((height * width, 3), np.uint8)
    texture[texels.pixel] = np.clip(np.rint(colours), 0, 255)
    filled = np.zeros(len(texture), bool)
    filled[texels.pixel] = True
    return _with_gutters(texture.reshape(height, width, 3), filled.reshape(height, width))


def _with_gutters(texture: UInt8, filled: Bool) -> UInt8:
    """Give texels between charts the colour of the nearest chart, for the smaller copies that viewers make."""
    if not filled.any():
        return texture
    _, nearest = cv2.distanceTransformWithLabels(
        (~filled).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    by_label = np.zeros((int(nearest.max()) + 1, 3), np.uint8)
    by_label[nearest[filled]] = texture[filled]
    return np.asarray(by_label[nearest], np.uint8)
