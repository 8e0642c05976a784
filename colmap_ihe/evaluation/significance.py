"""Tell whether one method is better than another, from all its matches and from runs without some of them.

COLMAP's mapper gives the same model for every seed, to ten digits, so that seeds do not show chance. Runs without a
random share of the matches do: the deviation over them, times sqrt((1 - share) / share), is the standard error of
the run with all (the delete-d jackknife, Shao and Wu 1989).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEFT_OUT = 0.2
"""Of the matches, in each of the runs that tell the error."""

_STUDENT = {2: 12.71, 3: 4.30, 4: 3.18, 5: 2.78, 6: 2.57, 7: 2.45, 8: 2.36, 9: 2.31, 10: 2.26}
"""Two-sided 5 % points of Student's distribution, by the number of runs."""


@dataclass(frozen=True)
class Verdict:
    """Hold the `difference` of the runs with all matches, in the unit of the values, and the verdict in `words`."""

    difference: float
    words: str


def standard_error(values: Sequence[float]) -> float:
    """Return the error of the value with all matches, from those without `LEFT_OUT` of them; nan for fewer than two."""
    if len(values) < 2:
        return float("nan")
    return float(np.std(values, ddof=1) * ((1 - LEFT_OUT) / LEFT_OUT) ** 0.5)


def verdict(values: Sequence[float], reference: Sequence[float], *, more_is_better: bool) -> Verdict:
    """Compare the values of two methods: the first with all matches, the others by the same seeds.

    Raises ValueError for unlike numbers of values, or none.
    """
    if len(values) != len(reference) or not values:
        raise ValueError(f"{len(values)} and {len(reference)} values, expected as many of both, at least one")
    differences = np.subtract(values, reference)
    difference, error = float(differences[0]), standard_error(differences[1:].tolist())
    if not differences.any():
        return Verdict(difference, "no difference")
    if np.isnan(error):
        return Verdict(difference, "one run: not decidable")
    if abs(difference) <= _STUDENT.get(len(differences) - 1, 2.2) * error:
        return Verdict(difference, "no difference that this test can see")
    return Verdict(difference, "better" if (difference > 0) == more_is_better else "worse")
