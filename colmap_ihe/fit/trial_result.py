"""Describe the result of a trial of greys: matches by grey, gains with their standard errors, and what follows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

REFERENCE = "rec709"
"""COLMAP's default grey, which the others are compared with."""
DEFAULT = "COLMAP's default grey"
SAME = "the grey is COLMAP's default"
"""Reason of a measurement that was not needed."""
_CLEAR = 2.0  # standard errors
_BETWEEN_PAIRS = 1.12  # pairs differ by so much more than their cells let expect: 19 pairs of two real sets


@dataclass(frozen=True)
class Counts:
    """Hold what one grey gave on one pair: features in both windows, putative matches, and verified ones by cell of
    the first window."""

    features: int
    putative: int
    cells: tuple[int, ...]

    @property
    def inliers(self) -> int:
        return sum(self.cells)

    def half(self, number: int) -> Counts:
        """Return the same with every other cell only, like the black (0) or the white (1) fields of a chessboard."""
        side = math.isqrt(len(self.cells))
        cells = [n for at, n in enumerate(self.cells) if (at // side + at % side) % 2 == number]
        return replace(self, cells=tuple(cells))


@dataclass(frozen=True)
class Candidate:
    """Hold what one grey gave on all pairs. `inliers` are verified matches, `by_pair` the same pair by pair. `gain`
    over the reference as a share of its inliers (.05 is 5 % more), `error` its standard error; 0 and 0 for the
    reference itself. A reference without inliers counts as one."""

    features: int
    putative: int
    inliers: int
    by_pair: tuple[int, ...]
    gain: float
    error: float

    @property
    def differs(self) -> bool:
        return abs(self.gain) > _CLEAR * self.error


@dataclass(frozen=True)
class TrialResult:
    """Hold what a trial measured. `pairs`: the photographs, two by two, by name. `candidates` by name, none if there
    is no pair: then `reason` says why. `held_out`: where one of several was chosen, what it gave on pairs, or on
    halves of pairs, that had no part in the choice: the winner of several is better by luck where it won."""

    pairs: tuple[tuple[str, str], ...] = ()
    candidates: tuple[tuple[str, Candidate], ...] = ()
    reason: str = ""
    held_out: TrialResult | None = None

    def of(self, name: str) -> Candidate | None:
        return dict(self.candidates).get(name)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "pairs": [list(pair) for pair in self.pairs],
            "candidates": {name: {**asdict(c), "by_pair": list(c.by_pair)} for name, c in self.candidates},
            "reason": self.reason,
            **({"held_out": self.held_out.as_dict()} if self.held_out else {}),
        }


def summed_up(
    pairs: Sequence[tuple[str, str]],
    names: Sequence[str],
    counts: Sequence[Sequence[Counts]],
    reason: str = "",
) -> TrialResult:
    """Sum up `counts` by pair and, in the order of `names`, by grey; the reference is one of them."""
    if not pairs:
        return TrialResult(reason=reason)
    cells = np.array([[c.cells for c in by_grey] for by_grey in counts], np.float64)  # pair, grey, cell
    reference = cells[:, names.index(REFERENCE)]
    candidates = []
    for number, name in enumerate(names):
        mine = [by_grey[number] for by_grey in counts]
        gain, error = gain_of(cells[:, number], reference)
        by_pair = tuple(c.inliers for c in mine)
        features, putative = sum(c.features for c in mine), sum(c.putative for c in mine)
        candidates.append((name, Candidate(features, putative, sum(by_pair), by_pair, gain, error)))
    return TrialResult(tuple(pairs), tuple(candidates))


def gain_of(cells: NDArray[np.float64], reference: NDArray[np.float64]) -> tuple[float, float]:
    """Return the gain of a grey over another and its standard error, from matches (pairs, cells) of both: the error of
    a ratio of sums (Cochran, Sampling Techniques, 6.2), with the cells that have matches as the sample."""
    total = max(1.0, float(reference.sum()))
    gain = (float(cells.sum()) - float(reference.sum())) / total
    residual = cells - (1 + gain) * reference
    count = max(2, int(np.count_nonzero(cells + reference)))
    spread = math.sqrt(count / (count - 1) * float(np.square(residual).sum()))
    return gain, _BETWEEN_PAIRS * spread / total


def leader_of(measured: TrialResult) -> str:
    """Return the candidate with most verified matches, the reference where there is none."""
    return max(measured.candidates, key=lambda c: c[1].inliers)[0] if measured.candidates else REFERENCE


def choose(measured: TrialResult) -> str:
    """Return the candidate with most verified matches if it is clearly better than the reference where it had no part
    in the choice, else the reference."""
    name = leader_of(measured)
    best = (measured.held_out or measured).of(name)
    return name if best is not None and best.differs and best.gain > 0 else REFERENCE


def in_words(measured: TrialResult, chosen: str, default: str = DEFAULT) -> str:
    """Return what the grey of this name brings, in one sentence, in losing cases too. `default`: what the reference is
    called."""
    if chosen == REFERENCE and measured.reason == SAME:
        return f"this is {default}: nothing to gain or to lose against it"
    where = "your photographs"
    if measured.held_out is not None and measured.held_out.of(chosen):
        is_half = set(measured.held_out.pairs) <= set(measured.pairs)
        where += f", {'in a half of them' if is_half else 'pairs'} that had no part in the choice,"
        measured = measured.held_out
    mine, reference = measured.of(chosen), measured.of(REFERENCE)
    if mine is None or reference is None:
        reason = measured.reason or f"{chosen} was not among the candidates"
        return f"what this grey brings on your photographs could not be measured: {reason}"
    pairs = f"{len(measured.pairs)} pair{'s' if len(measured.pairs) > 1 else ''}"
    gave = f"on {pairs} of {where} this grey gave {mine.inliers:,} verified matches"
    if chosen == REFERENCE:
        return f"{gave}; it is {default}"
    gave += f", {default} {reference.inliers:,}"
    if mine.gain > 1 and mine.differs:
        return gave
    percent, give_or_take = round(100 * abs(mine.gain)), max(1, math.ceil(100 * _CLEAR * mine.error))
    more = "more" if mine.gain > 0 else "fewer"
    if not mine.differs or not percent:
        return f"{gave}: no difference that this measurement can see (it would see {give_or_take} %)"
    sentence = f"{gave}: {percent} % {more} (give or take {give_or_take} %)"
    return f"{sentence}: `--set fit.method={REFERENCE}` would do better here" if mine.gain < 0 else sentence
