"""Look at the places of a model from a side: maps of their overlap, where it is weak, and a plan of the cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.checks.overlap import Flags, Float64, Ints, Places
from colmap_ihe.pipeline.model_verdict import WeakPart
from colmap_ihe.report.survey_contents import CameraPlan, OverlapMap

_ROUND = 0.5  # length of the mean direction of the photographs: with a shorter one they look from all sides
_STEEP = 0.7  # of the mean direction: more of it is down or up
_PARTS, _PART_PLACES, _PART_SHARE = 3, 5, 0.1  # that are named, and what each has of the weak places at least
_BESIDE = 2  # photographs that a part is named by


@dataclass(frozen=True)
class View:
    """Look at a model `words`, as "from the front": `right`, `up` and `toward` the eye are axes, (3,) each, in the
    frame of `ModelView`."""

    words: str
    right: tuple[int, int, int]
    up: tuple[int, int, int]
    toward: tuple[int, int, int]

    def seen(self, points: NDArray[np.floating] | NDArray[np.integer]) -> Float64:
        """Return (K, 3): points to the right, upwards and towards the eye."""
        return np.asarray(points, np.float64) @ np.array([self.right, self.up, self.toward], np.float64).T


FRONT = View("from the front", (1, 0, 0), (0, 1, 0), (0, 0, 1))
ABOVE = View("from above", (1, 0, 0), (0, 0, -1), (0, 1, 0))
BELOW = View("from below", (1, 0, 0), (0, 0, 1), (0, -1, 0))
RIGHT = View("from the right", (0, 0, -1), (0, 1, 0), (1, 0, 0))
BACK = View("from the back", (-1, 0, 0), (0, 1, 0), (0, 0, -1))
LEFT = View("from the left", (0, 0, 1), (0, 1, 0), (-1, 0, 0))


def views_of(directions: NDArray[np.floating]) -> list[View]:
    """Return the views that show what photographs with these viewing directions, (N, 3) of length 1, look at."""
    mean = np.asarray(directions, np.float64).mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < _ROUND:
        return [FRONT, RIGHT, BACK, LEFT]
    if abs(mean[1]) > _STEEP * length:
        return [ABOVE if mean[1] < 0 else BELOW]
    return [FRONT]


def overlap_map(places: Places, view: View) -> OverlapMap:
    """Return what is seen of the places, which are in the frame of the view: of those in a line the nearest."""
    seen = np.rint(view.seen(places.cells)).astype(np.int64)
    steps = seen[:, :2] - seen[:, :2].min(axis=0)
    order = np.lexsort((-seen[:, 2], steps[:, 1], steps[:, 0]))
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(steps[order], axis=0) != 0).any(axis=1)
    nearest = order[first]
    return OverlapMap(view.words, steps[nearest], places.photographs[nearest], places.narrow[nearest])


def camera_plan(
    places: Places, centres: NDArray[np.floating], directions: NDArray[np.floating], names: Sequence[str]
) -> CameraPlan:
    """Return where the cameras stand and look, with the places of the model: from above, or from the front if they
    differ more in height than in depth."""
    spread = np.ptp(centres, axis=0)
    view = FRONT if spread[1] > spread[2] else ABOVE
    corners = np.unique(view.seen(places.low + (places.cells + 0.5) * places.side)[:, :2].round(9), axis=0)
    seen, looks = view.seen(centres)[:, :2], view.seen(directions)[:, :2]
    return CameraPlan(view.words, corners, places.side, seen, looks, list(names))


def weak_parts(places: Places, weak: Flags, views: Sequence[View], names: Sequence[str]) -> list[WeakPart]:
    """Return where most of the `weak` places (K,) are, with the photographs, by `names`, that see most of them."""
    if not weak.any():
        return []
    parts = _parts_of(places.middles, views)
    counts = Counter(part for part, is_weak in zip(parts, weak, strict=True) if is_weak)
    least = max(_PART_PLACES, _PART_SHARE * int(weak.sum()))
    chosen = [(part, count) for part, count in counts.most_common(_PARTS) if count >= least]
    return [
        WeakPart(part, count, _beside(places, weak & (np.array(parts) == part), names))
        for part, count in chosen
    ]


def _beside(places: Places, chosen: Flags, names: Sequence[str]) -> list[str]:
    """Return the photographs that see most of the chosen places."""
    seen: Ints = np.bincount(places.image[chosen[places.place]], minlength=len(names))
    return [names[number] for number in np.argsort(-seen, kind="stable")[:_BESIDE] if seen[number]]


def _parts_of(middles: NDArray[np.floating], views: Sequence[View]) -> list[str]:
    """Return the part of the model, in words, that each place lies in: as the map shows it, or of a model that is seen
    from all sides, the side and the height."""
    if len(views) > 1:
        return _parts_around(middles)
    seen = views[0].seen(middles)
    across, up = _thirds(seen[:, 0]), _thirds(seen[:, 1])
    sides, heights = ("left", "", "right"), ("bottom", "", "top")
    words = [f"{heights[v]} {sides[u]}".strip() for u, v in zip(across, up, strict=True)]
    return [word or "middle" for word in words]


def _parts_around(middles: NDArray[np.floating]) -> list[str]:
    away = np.asarray(middles, np.float64) - np.median(middles, axis=0)
    sideways = np.abs(away[:, 0]) > np.abs(away[:, 2])
    sides = np.where(
        sideways, np.where(away[:, 0] > 0, "right", "left"), np.where(away[:, 2] > 0, "front", "back")
    )
    heights = np.array(["bottom", "middle", "top"])[_thirds(middles[:, 1])]
    return [f"{height} of the {side}" for height, side in zip(heights, sides, strict=True)]


def _thirds(values: NDArray[np.floating]) -> Ints:
    """Return (K,): 0, 1 or 2, the third of their extent that values lie in."""
    low, extent = float(values.min()), float(np.ptp(values)) or 1.0
    return np.asarray(np.clip((values - low) / extent * 3, 0, 2).astype(np.intp))
