"""Paint the texture: each texel from the photograph of its face, levelled, with gutters filled."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Array, Bool, Float32, Float64, Int32, Int64, UInt8
from colmap_ihe.dense.texture.atlas import Atlas, Patches
from colmap_ihe.dense.texture.raster import Covered, barycentric, covered
from colmap_ihe.dense.texture.seams import Integers, Reach, SeamPoints, seam_shifts

_SEAM_BLUR_PX = 1.5  # of the colours compared across seams: photographs are not aligned to less than a pixel
_RIM_TEXELS = 1.5
_SEAM_SHARES = (1.0, 0.5, 0.5)  # of the difference at seams that each round takes away
_FARTHEST = 20.0  # barycentric coordinate, beyond which a face is too thin to go on from
_MIXED_AT_ONCE = 50_000
_REMAP_ROW = 1024
_REMAP_ROWS = 16_384  # OpenCV takes no more than 32,766


def texels_of(atlas: Atlas, coloured: Bool) -> Covered:
    """Return each texel that a chart covers once, with a face of the atlas; where faces overlap, the last of those that
    are `coloured` (F,), else the last.

    A face that covers the centre of no texel gets the one that it lies in, else its colour would be its neighbour's.
    """
    face = np.full(atlas.size[0] * atlas.size[1], -1, np.int32)
    weights = np.zeros((len(face), 3), np.float32)
    corners = atlas.texel[atlas.faces]
    for rows in (np.flatnonzero(~coloured), np.flatnonzero(coloured)):
        for part in covered(corners[rows], atlas.size):
            face[part.pixel] = rows[part.face]
            weights[part.pixel] = part.weights
    empty = np.ones(len(corners) + 1, bool)
    empty[face] = False  # the last is where no face is
    small = np.flatnonzero(empty[:-1])
    column, row = np.clip(np.floor(corners[small].mean(axis=1)).T, 0, np.array([atlas.size]).T - 1)
    texel = (row * atlas.size[0] + column).astype(np.int64)
    free = face[texel] < 0
    face[texel[free]] = small[free]
    weights[texel[free]] = 1 / 3
    pixel = np.flatnonzero(face >= 0)
    return Covered(pixel.astype(np.int32), face[pixel], weights[pixel])


def sample(picture: UInt8 | Float32, pixels: Float64, scale: float = 1.0) -> Float32:
    """Return the colours (N, 3) float32 of a picture (H, W, 3) at `pixels` (N, 2), bilinear.

    Where `scale`, of texels per pixel, is well below one, they come from a picture of that scale.
    """
    source = picture.astype(np.float32)
    if scale < 0.75:
        height, width = picture.shape[:2]
        size = max(1, round(width * scale)), max(1, round(height * scale))
        source = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
        pixels = pixels * (size[0] / width, size[1] / height)
    count = len(pixels)
    rows = -(-count // _REMAP_ROW)
    positions = np.zeros((rows, _REMAP_ROW, 2), np.float32)
    positions.reshape(-1, 2)[:count] = pixels - 0.5
    colours = np.empty((rows, _REMAP_ROW, 3), np.float32)
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
    colours a face there; else it has its vertex colour."""
    colours = vertex_colours[patches.vertex].astype(np.float64)
    seen = np.zeros(len(colours), bool)
    seen[patches.faces[patches.coloured]] = True
    for number, picture in enumerate(pictures):
        members = seen & (patches.label == number)
        blurred = cv2.GaussianBlur(picture, (0, 0), _SEAM_BLUR_PX)
        colours[members] = sample(np.asarray(blurred, np.uint8), patches.pixel[members])
    return colours, seen


@dataclass(frozen=True)
class Paint:
    """Hold the texels that charts cover, not yet levelled: `texels` with their faces, the `corners` (T, 3) of the cut
    mesh around each with their `shares` (T, 3), and the `colours` (T, 3) float32."""

    texels: Covered
    corners: Int64
    shares: Float32
    colours: Float32


def paint(atlas: Atlas, patches: Patches, pictures: Iterable[UInt8], corners: Float64) -> Paint:
    """Return the colours of all texels in the photographs of their faces.

    Labels of `patches` are numbers of `pictures`, or above them. Where no photograph colours a face it has the colours
    `corners` (P, 3) of its corners.
    """
    texels = _with_rim(texels_of(atlas, patches.coloured), atlas)
    rows = atlas.source[atlas.faces][texels.face]
    label = np.where(patches.coloured[texels.face], patches.label[rows[:, 0]], -1)
    inside = np.clip(texels.weights, 0, 1)
    inside /= (inside[:, 0] + inside[:, 1] + inside[:, 2])[:, None]
    colours = np.empty((len(rows), 3), np.float32)
    plain = np.flatnonzero(label < 0)
    colours[plain] = _mixed(corners.astype(np.float32), rows[plain], inside[plain])
    for number, picture in enumerate(pictures):
        members = np.flatnonzero(label == number)
        if len(members):
            pixels = _mixed(patches.pixel, rows[members], texels.weights[members])
            colours[members] = sample(picture, pixels, atlas.scale)
    return Paint(texels, rows, inside, colours)


def _mixed(values: Array, rows: Int64, shares: Float32) -> Array:
    """Return (T, C), the sums of `values` (N, C) at `rows` (T, 3), by `shares` (T, 3). Some at a time, which stay in
    the cache of a core."""
    sums = np.empty((len(rows), values.shape[1]), np.result_type(values, shares))
    for start in range(0, len(rows), _MIXED_AT_ONCE):
        part = slice(start, start + _MIXED_AT_ONCE)
        first, second, third = (values[rows[part, k]] * shares[part, k, None] for k in range(3))
        sums[part] = first + second + third
    return sums


def bake(atlas: Atlas, patches: Patches, painted: Paint, offsets: Float64, points: SeamPoints) -> UInt8:
    """Return the texture, (height, width, 3) uint8 RGB, gamma-coded as the pictures.

    `offsets` (P, 3) of the corners of the cut mesh are added to what is `painted`, and what makes both sides agree at
    `points`.
    """
    texels = painted.texels
    colours = painted.colours + _mixed(offsets.astype(np.float32), painted.corners, painted.shares)
    if not len(colours):
        return np.zeros((*atlas.size[::-1], 3), np.uint8)
    everywhere = _nearest(texels, atlas)[1].reshape(atlas.size[::-1])
    reach = Reach.of(points, atlas.size, texels.pixel, patches.patch[texels.face])
    for share in _SEAM_SHARES:
        sides = sample(colours[everywhere], points.texel.reshape(-1, 2)).reshape(-1, 2, 3)
        shifts = share * seam_shifts(points, sides)
        reach.add(shifts, colours)
    return np.asarray(np.clip(np.rint(colours), 0, 255).astype(np.uint8)[everywhere])


def _with_rim(texels: Covered, atlas: Atlas) -> Covered:
    """Return `texels` and those just outside the charts, which viewers mix with those inside: by the face of the
    nearest texel, with barycentric coordinates outside of it."""
    if not len(texels.pixel):
        return texels
    distance, row = _nearest(texels, atlas)
    rim = np.flatnonzero((distance > 0) & (distance <= _RIM_TEXELS)).astype(np.int32)
    face = texels.face[row[rim]]
    return Covered(
        np.concatenate((texels.pixel, rim)),
        np.concatenate((texels.face, face)),
        np.concatenate((texels.weights, _weights(atlas, rim, face))),
    )


def _weights(atlas: Atlas, texels: Integers, face: Integers) -> Float32:
    """Return (M, 3) float32, the barycentric coordinates of the centres of `texels` in `face`, outside too."""
    row, column = np.divmod(texels, atlas.size[0])
    centre = np.stack((column + 0.5, row + 0.5), axis=1)
    a, b, c = np.moveaxis(atlas.texel[atlas.faces[face]], 1, 0)
    weights = barycentric(a, b, c, centre)
    wide = np.abs(weights).max(axis=1) < _FARTHEST
    return np.where(wide[:, None], weights, 1 / 3).astype(np.float32)


def _nearest(texels: Covered, atlas: Atlas) -> tuple[Float32, Int32]:
    """Return for each texel of the texture, row by row, the distance to the nearest of `texels` and its row there.

    So texels between charts get the colour of the nearest chart, for the smaller copies that viewers make.
    """
    width, height = atlas.size
    away = np.ones(width * height, np.uint8)
    away[texels.pixel] = 0
    distance, label = cv2.distanceTransformWithLabels(
        away.reshape(height, width), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    row = np.zeros(int(label.max()) + 1, np.int32)
    row[label.ravel()[texels.pixel]] = np.arange(len(texels.pixel))
    return np.asarray(distance.ravel(), np.float32), row[label.ravel()]
