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

LOOKED_AT = 16
"""Photographs, of a set of any size, for three pairs or more."""
_SIDE = 640  # pixels of the longer side of a small picture
_MAX_ERROR_PX = 2.0
_LEAST_SHARED = 30
_LEAST_SHIFT = 0.015  # of the longer side: with less, two photographs are nearly the same one
_PAIRS_TRIED = 60

Box = tuple[int, int, int, int]
"""Left, top, right, bottom in pixels, the last two exclusive."""


@dataclass(frozen=True, eq=False)
class Overlap:
    """Hold two photographs of one thing. `shared`: (N, 2, 2) float64, places in both, in shares of width and height."""

    first: Capture
    second: Capture
    shared: NDArray[np.float64]

    def boxes(
        self, sizes: tuple[tuple[int, int], tuple[int, int]], sides: tuple[int, int]
    ) -> tuple[Box, Box]:
        """Return a square in each, of these sides or less, where most of what they share is in both. `sizes`: width and
        height of both photographs, `sides` of the squares, in pixels."""
        pixels = self.shared * np.array(sizes, np.float64)
        half = np.array(sides, np.float64)[:, None] / 2

        def inside(centre: NDArray[np.float64]) -> NDArray[np.bool_]:
            return np.asarray((np.abs(pixels - centre) < half).all(axis=(1, 2)))

        centre = max(pixels, key=lambda c: int(inside(c).sum()))
        better = np.median(pixels[inside(centre)], axis=0)
        if inside(better).sum() >= inside(centre).sum():
            centre = better
        first, second = (_box(c, side, size) for c, side, size in zip(centre, sides, sizes, strict=True))
        return first, second


def _box(centre: NDArray[np.float64], side: int, size: tuple[int, int]) -> Box:
    across, down = min(side, size[0]), min(side, size[1])
    left = int(np.clip(round(centre[0] - across / 2), 0, size[0] - across))
    top = int(np.clip(round(centre[1] - down / 2), 0, size[1] - down))
    return left, top, left + across, top + down


def find_overlaps(
    captures: Sequence[Capture], count: int, executor: Executor, progress: Progress
) -> tuple[list[Overlap], str]:
    """Find pairs of photographs that overlap, `count` of them spread over the set first, any others after, and why
    there is none.

    At most `LOOKED_AT` photographs are opened: neighbours by name, at places spread evenly over the set.
    Those that cannot be read are passed over, and so are pairs of nearly the same photograph. Raises
    `NativeError`, `Cancelled`.
    """
    looked_at = _spread(captures, min(LOOKED_AT, 4 * (count + 1)))
    pictures: list[tuple[Capture, NDArray[np.uint8]]] = []

    def look(capture: Capture) -> NDArray[np.uint8] | None:
        try:
            return np.asarray(small_picture(capture, _SIDE).mean(axis=2) + 0.5, np.uint8)
        except PhotographError:
            return None

    progress.start(len(looked_at), "photographs looked at")
    for capture, grey in zip(looked_at, in_order(executor, look, looked_at, progress=progress), strict=True):
        progress.advance()
        if grey is not None:
            pictures.append((capture, grey))
    if len(pictures) < 2:
        return [], f"{len(captures)} photographs of its kind, of which {len(pictures)} could be read"
    features = features_of([grey for _, grey in pictures], progress, first_octave=0)

    def compare(pair: tuple[int, int]) -> Overlap | None:
        first, second = pair
        shared = _shared((pictures[first][1], pictures[second][1]), (features[first], features[second]))
        return None if shared is None else Overlap(pictures[first][0], pictures[second][0], shared)

    overlaps: list[Overlap] = []
    for pairs in _pairs_in_turn(len(pictures)):
        overlaps += [o for o in in_order(executor, compare, pairs) if o is not None]
        progress.check()
        if len(overlaps) >= count:
            break
    if not overlaps:
        return [], f"no two of the {len(pictures)} photographs looked at overlap clearly"
    spread = sorted({int(i) for i in np.linspace(0, len(overlaps) - 1, min(len(overlaps), count)).round()})
    return [overlaps[i] for i in [*spread, *(i for i in range(len(overlaps)) if i not in spread)]], ""


def _spread(captures: Sequence[Capture], most: int) -> list[Capture]:
    """Return all of a small set; of a large one neighbours two by two."""
    ordered = sorted(captures, key=lambda c: c.name)
    if len(ordered) <= most:
        return ordered
    starts = np.linspace(0, len(ordered) - 2, most // 2).astype(int)
    return [ordered[i + step] for i in starts for step in (0, 1)]


def _pairs_in_turn(count: int) -> Iterator[list[tuple[int, int]]]:
    """Yield neighbours; then, of a set whose names say nothing, pairs ever further apart, a few at a time."""
    yield [(i, i + 1) for i in range(count - 1)]
    others = sorted((p for p in combinations(range(count), 2) if p[1] - p[0] > 1), key=lambda p: p[1] - p[0])
    for begin in range(0, min(len(others), _PAIRS_TRIED), 10):
        yield others[begin : begin + 10]


def _shared(
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]], features: tuple[Features, Features]
) -> NDArray[np.float64] | None:
    """Return the places that both show, as in `Overlap`; None for too few, or nearly the same picture twice."""
    sizes = [(grey.shape[1], grey.shape[0]) for grey in pictures]
    pairs = match(*features)
    first, second = features[0].places[pairs[:, 0]], features[1].places[pairs[:, 1]]
    kept = verified(first, second, sizes[0], sizes[1], max_error_px=_MAX_ERROR_PX)
    if len(kept) < _LEAST_SHARED:
        return None
    if np.median(np.linalg.norm(first[kept] - second[kept], axis=1)) < _LEAST_SHIFT * max(sizes[0]):
        return None
    return np.stack((first[kept] / sizes[0], second[kept] / sizes[1]), axis=1)
