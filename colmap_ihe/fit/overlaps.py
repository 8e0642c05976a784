"""Find where photographs of a set overlap, from small versions of a few of them in one grey."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.two_views import Features, features_of, match, verified
from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.preview import small_picture

PAIRS = 6
"""Pairs of a trial at least: two to choose on, four to confirm it."""
LOOKED_AT = 15
"""Photographs, of a set of any size: five times three that follow each other by name."""
_GROUP = 3
_SIDE = 640  # pixels of the longer side of a small picture
_MAX_ERROR_PX = 2.0
_LEAST_SHARED = 30
_LEAST_SHIFT = 0.015  # of the longer side: with less, two photographs are nearly the same one
_PAIRS_TRIED = 60


@dataclass(frozen=True, eq=False)
class Overlap:
    """Hold two photographs of one thing. `at`: their numbers among those looked at, the smaller one first."""

    first: Capture
    second: Capture
    at: tuple[int, int]

    @property
    def names(self) -> tuple[str, str]:
        return self.first.name, self.second.name


@dataclass(frozen=True, eq=False)
class Plan:
    """Hold the pairs that a grey is chosen on, and those that confirm the choice."""

    choosing: tuple[Overlap, ...]
    confirming: tuple[Overlap, ...]

    @property
    def is_whole(self) -> bool:
        return len(self.choosing) + len(self.confirming) >= PAIRS


def plan_of(overlaps: Sequence[Overlap], is_large: bool) -> Plan:
    """Return at least `PAIRS` pairs, fewer only where there are not so many.

    In a large set a grey is chosen on three photographs of its middle and confirmed on three near each end. In a small
    one, or one whose names say nothing, few photographs with many pairs make the features cheap.
    """
    groups = [[o for o in overlaps if o.at[0] // _GROUP == o.at[1] // _GROUP == n] for n in range(LOOKED_AT)]
    places = [group for group in groups if len(group) >= 2]
    if is_large and len(places) >= 3:
        plan = Plan(tuple(places[len(places) // 2]), (*places[0], *places[-1]))
        if plan.is_whole:
            return plan
    pairs = _compact(overlaps)
    return Plan(tuple(pairs[:2]), tuple(pairs[2:]))


def _compact(overlaps: Sequence[Overlap]) -> list[Overlap]:
    """Return `PAIRS` pairs and more of few photographs: to the middle pair comes, again and again, the photograph with
    most pairs, and of equal ones that which is farthest away."""
    if not overlaps:
        return []
    members = set(overlaps[len(overlaps) // 2].at)
    pairs = [o for o in overlaps if members >= set(o.at)]
    while len(pairs) < PAIRS and len(pairs) < len(overlaps):
        others = sorted({n for o in overlaps for n in o.at} - members)

        def worth(other: int) -> tuple[int, int]:
            new = [o for o in overlaps if other in o.at and set(o.at) <= members | {other}]
            return len(new), min(abs(other - n) for n in members)

        best = max(others, key=worth)
        members.add(best)
        pairs += [o for o in overlaps if best in o.at and set(o.at) <= members]
    return pairs


def find_overlaps(
    captures: Sequence[Capture], executor: Executor, progress: Progress
) -> tuple[list[Overlap], str]:
    """Find pairs of photographs that overlap, in the order of names, and why there is none.

    At most `LOOKED_AT` photographs are opened: neighbours by name, at places spread evenly over the set.
    Those that cannot be read are passed over, and so are pairs of nearly the same photograph. Raises
    `NativeError`, `Cancelled`.
    """
    looked_at = _spread(captures)
    pictures: list[tuple[int, Capture, NDArray[np.uint8]]] = []

    def look(capture: Capture) -> NDArray[np.uint8] | None:
        try:
            return np.asarray(small_picture(capture, _SIDE).mean(axis=2) + 0.5, np.uint8)
        except PhotographError:
            return None

    progress.start(len(looked_at), "photographs looked at")
    for number, grey in enumerate(in_order(executor, look, looked_at, progress=progress)):
        progress.advance()
        if grey is not None:
            pictures.append((number, looked_at[number], grey))
    if len(pictures) < 2:
        return [], f"{len(captures)} photographs of its kind, of which {len(pictures)} could be read"
    features = features_of([grey for _, _, grey in pictures], progress, first_octave=0)

    def compare(pair: tuple[int, int]) -> Overlap | None:
        first, second = pair
        one, one_capture, one_grey = pictures[first]
        other, other_capture, other_grey = pictures[second]
        if not _overlap((one_grey, other_grey), (features[first], features[second])):
            return None
        return Overlap(one_capture, other_capture, (one, other))

    overlaps: list[Overlap] = []
    for pairs in _pairs_in_turn(len(pictures)):
        overlaps += [o for o in in_order(executor, compare, pairs) if o is not None]
        progress.check()
        if len(overlaps) >= PAIRS:
            break
    if not overlaps:
        return [], f"no two of the {len(pictures)} photographs looked at overlap clearly"
    return sorted(overlaps, key=lambda o: o.at), ""


def _spread(captures: Sequence[Capture]) -> list[Capture]:
    """Return all of a small set; of a large one neighbours three by three."""
    ordered = sorted(captures, key=lambda c: c.name)
    if len(ordered) <= LOOKED_AT:
        return ordered
    starts = np.linspace(0, len(ordered) - _GROUP, LOOKED_AT // _GROUP).astype(int)
    return [ordered[i + step] for i in starts for step in range(_GROUP)]


def _pairs_in_turn(count: int) -> Iterator[list[tuple[int, int]]]:
    """Yield near neighbours; then, of a set whose names say nothing, pairs ever further apart, a few at a time."""
    every = sorted(combinations(range(count), 2), key=lambda p: p[1] - p[0])
    near = [p for p in every if p[1] - p[0] <= _GROUP]
    yield near
    others = every[len(near) :]
    for begin in range(0, min(len(others), _PAIRS_TRIED), 10):
        yield others[begin : begin + 10]


def _overlap(
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]], features: tuple[Features, Features]
) -> bool:
    """Tell whether two pictures show one thing, and are not nearly the same picture twice."""
    sizes = [(grey.shape[1], grey.shape[0]) for grey in pictures]
    pairs = match(*features)
    first, second = features[0].places[pairs[:, 0]], features[1].places[pairs[:, 1]]
    kept = verified(first, second, sizes[0], sizes[1], max_error_px=_MAX_ERROR_PX)
    if len(kept) < _LEAST_SHARED:
        return False
    shift = float(np.median(np.linalg.norm(first[kept] - second[kept], axis=1)))
    return shift >= float(_LEAST_SHIFT * max(sizes[0]))
