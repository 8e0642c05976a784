"""Describe the result of a trial of greys: matches by grey, gains with their standard errors, and what follows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.weights import Encoding

REFERENCE = "rec709"
"""COLMAP's default grey, which the others are compared with."""
DEFAULT = "COLMAP's default grey"
SAME = "the grey is COLMAP's default"
"""Reason of a measurement that was not needed."""
_DEFAULTS: Mapping[Encoding, str] = {
    "coded": DEFAULT,
    "linear": "the default grey of developed photographs (Rec.709 after white balance)",
}
_CLEAR = 2.0  # standard errors
_BETWEEN_PAIRS = 1.3  # pairs differ by so much more than their cells let expect: 24 trials of eight sets


@dataclass(frozen=True)
class Counts:
    """Hold what one grey gave on one pair: features in both photographs, putative matches, and verified ones by cell
    of the first photograph."""

    features: int
    putative: int
    cells: tuple[int, ...]

    @property
    def inliers(self) -> int:
        return sum(self.cells)


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
    is no pair. `reason` says why there are too few pairs or none. `held_out`: what the best gave on pairs that had no
    part in the choice: the winner is better by luck where it won."""

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
    a ratio of sums (Cochran, Sampling Techniques, 6.2), with the cells that have matches as the sample, or the pairs,
    whichever is larger: COLMAP keeps whole levels of scale, and one more or less shifts all cells of a pair."""
    total = max(1.0, float(reference.sum()))
    gain = (float(cells.sum()) - float(reference.sum())) / total
    residual = cells - (1 + gain) * reference
    count = max(2, int(np.count_nonzero(cells + reference)))
    spread = math.sqrt(count / (count - 1) * float(np.square(residual).sum()))
    by_pair = residual.sum(axis=1) - residual.sum(axis=1).mean()
    whole = math.sqrt(len(by_pair) / max(1, len(by_pair) - 1) * float(np.square(by_pair).sum()))
    return gain, max(_BETWEEN_PAIRS * spread, whole) / total


def leader_of(measured: TrialResult) -> str:
    """Return the candidate with most verified matches, the reference where there is none."""
    return max(measured.candidates, key=lambda c: c[1].inliers)[0] if measured.candidates else REFERENCE


def choose(measured: TrialResult) -> str:
    """Return the candidate with most verified matches if it is clearly better than the reference on the pairs that
    confirm it, else the reference."""
    name = leader_of(measured)
    best = measured.held_out.of(name) if measured.held_out else None
    return name if best is not None and best.differs and best.gain > 0 else REFERENCE


def is_clearly_worse(measured: TrialResult, name: str) -> bool:
    """Tell whether a grey lost matches against the reference, and clearly so on the pairs that confirm it."""
    first, then = measured.of(name), measured.held_out.of(name) if measured.held_out else None
    return first is not None and then is not None and first.gain < 0 and then.gain < 0 and then.differs


def in_words(measured: TrialResult, chosen: str, default: str = DEFAULT, fitted: str = "") -> str:
    """Return what the grey of this name brings, in one sentence, in losing cases too. `default`: what the reference is
    called; `fitted`: the weights of the grey that the reference was taken instead of."""
    if chosen == REFERENCE and measured.reason == SAME:
        return f"this is {default}: nothing to gain or to lose against it"
    if fitted:
        return f"this set keeps {default}: {_why_not(measured, fitted)}"
    shown = measured.held_out if measured.held_out and measured.held_out.of(chosen) else measured
    mine, reference = shown.of(chosen), shown.of(REFERENCE)
    if mine is None or reference is None:
        reason = measured.reason or f"{chosen} was not among the candidates"
        return f"what this grey brings on your photographs could not be measured: {reason}"
    where = " that had no part in the choice," if shown is not measured else ""
    gave = f"on {_pairs(shown)} of your photographs{', pairs' + where if where else ''}"
    gave += f" this grey gave {mine.inliers:,} verified matches"
    if chosen == REFERENCE:
        return f"{gave}; it is {default}"
    sentence = f"{gave}, {default} {reference.inliers:,}{_difference(mine)}"
    if mine.gain < 0 and mine.differs and round(100 * mine.gain):
        return f"{sentence}: `--set fit.method={REFERENCE}` would do better here"
    return sentence


def _why_not(measured: TrialResult, fitted: str) -> str:
    shown = measured.held_out or measured
    other = next((c for name, c in shown.candidates if name != REFERENCE), None)
    reference = shown.of(REFERENCE)
    if other is None or reference is None or measured.reason:
        return f"the fitted one ({fitted}) could not be tried: {measured.reason}"
    gave = f"on {_pairs(shown)} of your photographs the fitted one ({fitted}) gave {other.inliers:,} verified matches"
    return f"{gave}, and this {reference.inliers:,}{_difference(other)}"


def _pairs(measured: TrialResult) -> str:
    return f"{len(measured.pairs)} pair{'s' if len(measured.pairs) > 1 else ''}"


def _difference(mine: Candidate) -> str:
    if mine.gain > 1 and mine.differs:
        return ""
    percent, give_or_take = round(100 * abs(mine.gain)), max(1, math.ceil(100 * _CLEAR * mine.error))
    more = "more" if mine.gain > 0 else "fewer"
    if not mine.differs or not percent:
        return f": no difference that this measurement can see (it would see {give_or_take} %)"
    return f": {percent} % {more} (give or take {give_or_take} %)"


@dataclass(frozen=True)
class ChosenGrey:
    """Hold what was measured on the photographs, and which of the candidates the grey is. `fitted`: the weights that
    it was taken instead of, where the trial kept the default."""

    chosen: str
    measured: TrialResult
    encoding: Encoding = "coded"
    fitted: tuple[float, float, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        fitted = " ".join(f"{w:.2f}" for w in self.fitted or ())
        words = in_words(self.measured, self.chosen, _DEFAULTS[self.encoding], fitted)
        instead = {"fitted": list(self.fitted)} if self.fitted else {}
        return {"chosen": self.chosen, "in_words": words, **instead, **self.measured.as_dict()}
