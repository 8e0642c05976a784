"""Make colours meet along seams, texel by texel.

Offsets of corners (see `level`) make the means of two patches alike; what is left at their border are details that two
photographs do not show at the same pixel. So points are laid along each seam, closer than texels, and the difference
of the two sides there is shared between them and fades within a few texels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int64
from colmap_ihe.dense.texture.atlas import Atlas, Patches

Integers = npt.NDArray[np.integer[Any]]

_POINTS_A_TEXEL = 2
_FADE_TEXELS = 6.0  # from a seam, where a difference has gone


@dataclass(frozen=True)
class SeamPoints:
    """Hold points along the seams, each with its two sides: `texel` (N, 2, 2) float64, the place on the texture;
    `patch` (N, 2); `coloured` (N, 2), false where no photograph colours the face."""

    texel: Float64
    patch: Int64
    coloured: Bool


def seam_points(patches: Patches, atlas: Atlas) -> SeamPoints:
    """Lay points along the edges at which two patches meet, two for each texel of the longer side."""
    halves = _seam_halves(patches)
    face = halves // 3
    at = np.stack((halves % 3, (halves + 1) % 3), axis=2)
    vertex = patches.vertex[patches.faces[face[:, :, None], at]]
    turned = vertex[:, :, 0] > vertex[:, :, 1]
    at = np.where(turned[:, :, None], at[:, :, ::-1], at)
    ends = atlas.texel[atlas.faces[face[:, :, None], at]]
    length = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1, initial=0)
    count = np.maximum(np.ceil(_POINTS_A_TEXEL * length), 1).astype(np.int64)
    edge = np.repeat(np.arange(len(count)), count)
    first = np.repeat(np.cumsum(count) - count, count)
    share = ((np.arange(len(edge)) - first + 0.5) / count[edge])[:, None, None]
    texel = (1 - share) * ends[edge, :, 0] + share * ends[edge, :, 1]
    return SeamPoints(texel, patches.patch[face][edge], patches.coloured[face][edge])


def _seam_halves(patches: Patches) -> Int64:
    """Return (S, 2): for each edge between two patches the numbers of its sides, three times the face plus the place of
    its first corner there."""
    ends = np.sort(patches.vertex[patches.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)], axis=1)
    key = ends[:, 0] * (int(patches.vertex.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    halves = np.stack((order[same], order[same + 1]), axis=1)
    patch = patches.patch[halves // 3]
    return np.asarray(halves[patch[:, 0] != patch[:, 1]])


def seam_shifts(points: SeamPoints, colours: Float32) -> Float32:
    """Return (N, 2, 3): what to add to the `colours` (N, 2, 3) of both sides so that they agree. Both give half; but
    beside a photograph the side without one gives all."""
    part = np.where(points.coloured[:, 0] == points.coloured[:, 1], 0.5, points.coloured[:, 1]).astype(
        np.float32
    )
    difference = colours[:, 1] - colours[:, 0]
    return np.stack((part[:, None] * difference, (part[:, None] - 1) * difference), axis=1)


@dataclass(frozen=True)
class Reach:
    """Hold how far what is added at seam points goes on: `point` (2 N,), the place of each side of a point, of so many
    `places`; `texel` (M,), the rows of the texels near one of these in the same patch, `nearest` (M,), which place that
    is, and `fade` (M,), 1 there and less with distance."""

    point: Int64
    places: int
    texel: Int64
    nearest: Int64
    fade: Float32

    @classmethod
    def of(cls, points: SeamPoints, size: tuple[int, int], texels: Integers, patch: Int64) -> Reach:
        """Return it for `texels` (T,), row-major numbers on a texture of `size` (width, height), of the patches `patch`
        (T,)."""
        nothing = np.zeros(0, np.int64)
        if not len(points.patch):
            return cls(nothing, 0, nothing, nothing, np.zeros(0, np.float32))
        column, row = np.clip(np.floor(points.texel.reshape(-1, 2)), 0, np.array(size) - 1).T.astype(np.int64)
        place, point = np.unique(row * size[0] + column, return_inverse=True)
        owner = np.empty(len(place), np.int64)
        owner[point] = points.patch.ravel()
        away = np.ones(size[0] * size[1], np.uint8)
        away[place] = 0
        distance, label = cv2.distanceTransformWithLabels(
            away.reshape(size[::-1]), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        rank = np.zeros(len(place) + 1, np.int64)
        rank[label.ravel()[place]] = np.arange(len(place))
        fade = 1 - distance.ravel()[texels] / _FADE_TEXELS
        near = np.flatnonzero(fade > 0)
        nearest = rank[label.ravel()[texels[near]]]
        same = owner[nearest] == patch[near]
        return cls(point, len(place), near[same], nearest[same], fade[near[same]])

    def add(self, shifts: Float32, colours: Float32) -> None:
        """Add to the `colours` (T, 3) float32 of the texels the `shifts` (N, 2, 3) of the nearest seam points."""
        if not self.places:
            return
        count = np.bincount(self.point, minlength=self.places)
        for channel, values in enumerate(shifts.reshape(-1, 3).T):
            mean = np.bincount(self.point, values, self.places) / count
            colours[self.texel, channel] += (mean[self.nearest] * self.fade).astype(np.float32)
