"""Try candidate greys on a few pairs of the set's own photographs: how many matches each brings.

Detail, noise and compression differ from set to set, so no rule knows beforehand which grey matches best; a
small measurement does. Every candidate gets the same windows of the same pairs, at the resolution at which
COLMAP will work: what JPEG does to colour shows only there. The gain over Rec.709, COLMAP's default, comes
with its standard error, from how it varies over the windows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import islice
from types import MappingProxyType
from typing import Literal

import numpy as np

from colmap_ihe.colmap.native import quiet
from colmap_ihe.fit.overlaps import find_overlaps
from colmap_ihe.fit.trial_bench import Bench, Pair, Trial, readable_pairs
from colmap_ihe.fit.trial_result import REFERENCE, Counts, TrialResult, leader_of, summed_up
from colmap_ihe.grey.weights import Encoding, Grey, Weights, shares, triplets
from colmap_ihe.machine.executor import threads_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.decode import encoding_of
from colmap_ihe.photographs.discover import Capture

PAIRS = 3
_PHOTOGRAPHS_A_PAIR = 8
"""A pair is measured for so many photographs: on a few, three pairs would take as long as finding their features."""
_Role = Literal["screen", "choose", "hold out"]
_ROLES: tuple[tuple[_Role, ...], ...] = (
    (),
    ("choose",),  # and held out by halves
    ("choose", "hold out"),
    ("choose", "hold out", "hold out"),
    ("screen", "choose", "hold out", "hold out"),
    ("screen", "choose", "choose", "hold out", "hold out"),
)
"""What pairs are for where one of several greys is chosen, by their number."""
_Measured = tuple[tuple[str, str], list[Counts]]
"""The names of a pair, and what each grey gave on it."""
_SCREENED = 4  # so many times smaller are the windows in which the grid is screened


def measure(
    captures: Sequence[Capture],
    greys: Mapping[str, Grey],
    executor: Executor,
    progress: Progress,
    trial: Trial,
    screen: Mapping[str, Grey] = MappingProxyType({}),
) -> TrialResult:
    """Return verified matches of each of `greys` on one to three pairs of photographs.

    One of `greys` is named "rec709", and all are for one encoding; captures of another are passed over. With `screen`
    one is to be chosen: the best of `screen` on one pair, in smaller windows, is measured with the others, and the
    winner measured once more on pairs that had no part in the choice. The same photographs give the same
    answer. Photographs that cannot be read are passed over; without a pair that overlaps the result has none, and says
    why. Raises ValueError for greys as above, `NativeError`, `Cancelled`.
    """
    encodings = {g.encoding for g in (*greys.values(), *screen.values())}
    if REFERENCE not in greys or len(encodings) != 1:
        raise ValueError(f"{sorted(greys)=} {encodings=}, expected {REFERENCE} among them and one encoding")
    members = [c for c in captures if encoding_of(c) in encodings]
    if len(members) < 2:
        return TrialResult(reason=f"a pair takes two photographs, and there are {len(members)} of this kind")
    with quiet(), threads_of(executor) as threads:
        few = min(PAIRS, max(1, round(len(members) / _PHOTOGRAPHS_A_PAIR)))
        count = len(_ROLES) - 1 if screen else few
        overlaps, reason = find_overlaps(members, count, threads, progress)
        pairs = readable_pairs(Bench(threads, progress, trial, greys[REFERENCE]), overlaps)
        reason = "the photographs that overlap cannot be read in full" if overlaps else reason
        if screen:
            return _choose(pairs, min(count, len(overlaps)), greys, screen, reason)
        return _measure(pairs, few, greys, reason)


def coarse_grid(encoding: Encoding, step: float = 0.25) -> dict[str, Weights]:
    """Return the triplets of a coarse grid, to be screened, by the name they have among candidates; of a linear set
    still without its white points."""
    grid = (shares(triplet) for triplet in triplets(step))
    return {" ".join(f"{w:g}" for w in weights): Weights(*weights, "grid", encoding) for weights in grid}


def _measure(pairs: Iterable[Pair], count: int, greys: Mapping[str, Grey], reason: str) -> TrialResult:
    return _summed([(pair.names, pair.counts(greys)) for pair in islice(pairs, count)], greys, reason)


def _choose(
    pairs: Iterable[Pair], count: int, greys: Mapping[str, Grey], screen: Mapping[str, Grey], reason: str
) -> TrialResult:
    """Measure the greys and the best of the grid on the first of `count` pairs, and the winner on the last ones. The
    grid is screened on a pair that is not measured afterwards, if there is one to spare: a grey that was lucky there
    has no luck left."""
    tried, best_two = dict(greys), dict[str, Grey]()
    chosen_on: list[_Measured] = []
    held_out: list[_Measured] = []
    for role, pair in zip(_ROLES[count], pairs, strict=False):
        if tried.keys() == greys.keys():
            inliers = [c.inliers for c in pair.counts(screen, _SCREENED)]
            best = list(screen)[int(np.argmax(inliers))]
            tried[best] = screen[best]
        if role == "choose":
            chosen_on.append((pair.names, pair.counts(tried)))
        elif role == "hold out":
            leader = leader_of(_summed(chosen_on, tried))
            best_two = best_two or {REFERENCE: tried[REFERENCE], leader: tried[leader]}
            held_out.append((pair.names, pair.counts(best_two)))
    if held_out:
        return replace(_summed(chosen_on, tried, reason), held_out=_summed(held_out, best_two))
    first, second = ([(names, [c.half(n) for c in row]) for names, row in chosen_on] for n in (0, 1))
    return replace(_summed(first, tried, reason), held_out=_summed(second, tried, reason))


def _summed(pairs: Sequence[_Measured], greys: Mapping[str, Grey], reason: str = "") -> TrialResult:
    return summed_up([names for names, _ in pairs], list(greys), [counts for _, counts in pairs], reason)
