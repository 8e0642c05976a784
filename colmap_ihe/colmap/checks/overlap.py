"""Count how many photographs see each place of a model, and at what angles: arrays in, arrays out."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]

ENOUGH = 3
"""Photographs of a place: two always agree on a depth, wherever they look, and only a third can contradict them."""
WIDE_DEG = 6.0
"""Between the rays to a place: below it depth is 10 times as uncertain as what lies across, for 1 / tan 6° is 9.5."""
_ACROSS = 32  # places on the longest side of the box of the middle 90 percent of the points
_STRAYS = 5.0  # percent of the points at each end of an axis, which may lie anywhere
_BEYOND = 0.25  # of the longest side: what lies farther out of that box is background, or false
_FAR = (
    2.5  # times the median distance from the nearest camera: a pixel shows that much more there: background
)
_POINTS = 2  # of a place: one alone may be a false match
_MOST_RAYS = 64  # of a place, between which angles are looked for


@dataclass(frozen=True)
class Places:
    """Hold K cubes of space in which points lie: `cells` (K, 3) int64, by steps of `side` from `low` (3,); the
    `middles` (K, 3) of their points; the number of `photographs` (K,) that see them, and the largest angle
    `angles_deg` (K,) between the rays from there. Of each photograph of each place `place` (S,) and `image` (S,)."""

    low: Float64
    side: float
    extent: Float64
    cells: NDArray[np.int64]
    middles: Float64
    photographs: Ints
    angles_deg: Float64
    place: Ints
    image: Ints

    @property
    def few(self) -> Flags:
        """Return (K,) bool: the places that fewer than `ENOUGH` photographs see."""
        return np.asarray(self.photographs < ENOUGH)

    @property
    def narrow(self) -> Flags:
        """Return (K,) bool: the places that enough photographs see, and all from about one side."""
        return np.asarray(~self.few & (self.angles_deg < WIDE_DEG))


def places_of(points: Float64, point: Ints, image: Ints, centres: Float64) -> Places | None:
    """Return the places of points (P, 3); `image` (M,) sees `point` (M,), by number; `centres` (N, 3) of the cameras.
    The background counts for none. None where no two points are together."""
    near = _near(points, point, image, centres)
    points, (point, image) = points[near], _of_points(near, point, image)
    if len(points) < _POINTS:
        return None
    low, high = np.percentile(points, (_STRAYS, 100 - _STRAYS), axis=0)
    longest = float((high - low).max()) or 1.0
    side, low, high = longest / _ACROSS, low - _BEYOND * longest, high + _BEYOND * longest
    steps = np.floor((points - low) / side).astype(np.int64)
    inside = ((points >= low) & (points <= high)).all(axis=1)
    cells, of_point, counts = np.unique(steps, axis=0, return_inverse=True, return_counts=True)
    of_point = of_point.ravel()
    kept = (counts >= _POINTS) & (np.bincount(of_point, inside, len(cells)) > 0)
    if not kept.any():
        return None
    number = np.cumsum(kept) - 1
    sums = np.stack([np.bincount(of_point, points[:, k], len(cells)) for k in range(3)], axis=1)
    middles = (sums / counts[:, None])[kept]
    seen = kept[of_point[point]]
    pairs = np.unique(number[of_point[point[seen]]] * len(centres) + image[seen])
    place, seeing = (np.asarray(part, np.intp) for part in np.divmod(pairs, len(centres)))
    return Places(
        low,
        side,
        high - low,
        cells[kept],
        middles,
        np.bincount(place, minlength=len(middles)),
        _widest_angles(middles, place, centres[seeing]),
        place,
        seeing,
    )


def _near(points: Float64, point: Ints, image: Ints, centres: Float64) -> Flags:
    """Return (P,) bool: the points that are no background."""
    nearest = np.full(len(points), np.inf)
    np.minimum.at(nearest, point, np.linalg.norm(points[point] - centres[image], axis=1))
    return np.asarray(nearest <= _FAR * np.median(nearest)) if len(points) else np.zeros(0, bool)


def _of_points(kept: Flags, point: Ints, image: Ints) -> tuple[Ints, Ints]:
    """Return `point` and `image` of the points (P,) that are kept, which count anew."""
    seen = kept[point]
    return (np.cumsum(kept) - 1)[point[seen]], image[seen]


def _widest_angles(middles: Float64, place: Ints, centres: Float64) -> Float64:
    """Return (K,): the largest angle at each middle between two of the cameras that see it, in degrees."""
    rays = centres - middles[place]
    rays /= np.maximum(np.linalg.norm(rays, axis=1), 1e-12)[:, None]
    starts = np.searchsorted(place, np.arange(len(middles) + 1))
    angles = np.zeros(len(middles))
    for number, (begin, end) in enumerate(pairwise(starts)):
        if end - begin > 1:
            some = rays[begin:end][:: -(-(end - begin) // _MOST_RAYS)]
            angles[number] = np.degrees(np.arccos(np.clip((some @ some.T).min(), -1.0, 1.0)))
    return angles
