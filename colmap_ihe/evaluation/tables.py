"""Tell what a comparison of methods came to: its figures, its tables, sentences about them, and whether one method is
better than another.

COLMAP's mapper gives the same model for every seed, to ten digits, so that seeds do not show chance. Runs without a
random share of the matches do: the deviation over them, times sqrt((1 - share) / share), is the standard error of
the run with all (the delete-d jackknife, Shao and Wu 1989).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_ihe.evaluation.pair_errors import MOVEMENTS
from colmap_ihe.report.tables import Table, second_in_words

METHODS = ("ihe", "ihe-second", "rec709", "rgb2gray", "green", "photoshop", "decolorize", "realtime")
PAPER = "ihe-paper"
"""IHE without the guard, to the letter of the paper."""
SECOND = "ihe-second"
"""IHE with a second grey for what it loses; all other methods are compared without."""
REFERENCE = "rec709"
LEFT_OUT = 0.2
"""Of the matches, in each of the runs that tell the error."""

_STUDENT = {2: 12.71, 3: 4.30, 4: 3.18, 5: 2.78, 6: 2.57, 7: 2.45, 8: 2.36, 9: 2.31, 10: 2.26}
"""Two-sided 5 % points of Student's distribution, by the number of runs."""


@dataclass(frozen=True)
class MethodResult:
    """Hold what was measured of one method.

    `runs`: 0 with all matches, 1 and up without some of them, by seed; each with `registered`, `points`,
    `points_over_3_views`, `mean_error_px`, `rms_px`, and where truth is known `rotation_deg`, `position_m`,
    `auc_percent`, and of a project with a survey what `metric.GivenSurvey.figures_of` gives. `matching`: pairs,
    putative matches, inliers and their share in percent, over all pairs and by the camera's movement. `dense_points`
    with the cameras of the first method, None where dense stereo did not run. `second_grey`: as the summary has it,
    None without.
    """

    method: str
    weights: tuple[float, ...] | None
    matching: Mapping[str, Mapping[str, Any]]
    runs: Mapping[int, Mapping[str, float]]
    dense_points: int | None
    second_grey: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Verdict:
    """Hold the `difference` of the runs with all matches, in the unit of the values, and the verdict in `words`."""

    difference: float
    words: str


@dataclass(frozen=True)
class _Figure:
    """Describe a figure that differs from seed to seed; `decimals` are shown."""

    name: str
    title: str
    decimals: int
    more_is_better: bool


_FIGURES = (
    _Figure("registered", "registered", 1, True),
    _Figure("rms_px", "RMS px", 3, False),
    _Figure("points", "points", 0, True),
    _Figure("points_over_3_views", "points in > 3 images", 0, True),
    _Figure("rotation_deg", "rotation error deg", 4, False),
    _Figure("position_m", "position error m", 5, False),
    _Figure("auc_percent", "AUC at 5 deg %", 2, True),
    _Figure("check_rms_mm", "check points RMS mm", 2, False),
    _Figure("control_rms_mm", "control points RMS mm", 2, False),
)


def tables_of(results: Sequence[MethodResult]) -> list[Table]:
    """Return tables 1 to 3 of the paper, and the differences from the reference where there are several methods."""
    tables = [_matching(results), _reconstruction(results)]
    return [*tables, _differences(results)] if len(results) > 1 else tables


def sentences(results: Sequence[MethodResult]) -> list[str]:
    """Say which greys are compared, and the differences from the reference in words, one method a sentence."""
    lines = [_which_greys(results)]
    for method, verdicts in _verdicts(results).items():
        parts = []
        for word in ("better", "worse"):
            titles = [f.title for f, judged in verdicts.items() if judged.words == word]
            parts += [f"{word} in {', '.join(titles)}"] if titles else []
        differences = "; ".join(parts) or "no difference that this test can see"
        lines.append(f"{method} against {_reference(results).method}: {differences}.")
    return lines


def _which_greys(results: Sequence[MethodResult]) -> str:
    second = next((result for result in results if result.second_grey), None)
    if second is None or second.second_grey is None:
        return "Each grey is compared alone, without a second grey for what it loses."
    return (
        f"{second.method} has a second grey for what the first loses, the others are alone:"
        f" {second_in_words(second.second_grey)}."
    )


def _matching(results: Sequence[MethodResult]) -> Table:
    kinds = [k for k in ("all", *MOVEMENTS) if results[0].matching[k]["pairs"]]
    columns = ["method", "weights", "putative", "inliers"]
    columns += [f"{kind}, % of putative ({results[0].matching[kind]['pairs']} pairs)" for kind in kinds]
    rows = []
    for result in results:
        weights = "-" if result.weights is None else " ".join(f"{w:.2f}" for w in result.weights)
        counts = result.matching["all"]
        shares = [result.matching[kind]["efficiency_percent"] for kind in kinds]
        percents = ["-" if share is None else f"{share:.1f}" for share in shares]
        rows.append([result.method, weights, f"{counts['putative']:,}", f"{counts['inliers']:,}", *percents])
    return Table("matching", "Pairwise matching efficiency: inliers of putative matches", columns, rows)


def _reconstruction(results: Sequence[MethodResult]) -> Table:
    figures = _measured(results)
    metric = all("extent_m" in run for result in results for run in result.runs.values())
    columns = ["method", *(f.title for f in figures), *(["extent m"] if metric else [])]
    columns.append("dense points, same cameras")
    rows = []
    for result in results:
        runs = [run for _, run in sorted(result.runs.items())]
        values = [_with_error([run[f.name] for run in runs], f.decimals) for f in figures]
        values += [_with_error([run["extent_m"] for run in runs], 2)] if metric else []
        dense = "-" if result.dense_points is None else f"{result.dense_points:,}"
        rows.append([result.method, *values, dense])
    title = (
        f"Reconstruction +- standard error, from {len(results[0].runs) - 1} runs"
        f" without {100 * LEFT_OUT:.0f} % of the matches"
    )
    return Table("reconstruction", title, columns, rows)


def _differences(results: Sequence[MethodResult]) -> Table:
    rows = [
        [method, *(f"{v.difference:+,.{f.decimals}f} ({v.words})" for f, v in verdicts.items())]
        for method, verdicts in _verdicts(results).items()
    ]
    title = f"Differences from {_reference(results).method}, paired by seed"
    return Table("differences", title, ["method", *(f.title for f in _measured(results))], rows)


def _reference(results: Sequence[MethodResult]) -> MethodResult:
    """Return COLMAP's default, or the first method where it was not measured."""
    return next((result for result in results if result.method == REFERENCE), results[0])


def _verdicts(results: Sequence[MethodResult]) -> dict[str, dict[_Figure, Verdict]]:
    """Judge each method but the reference against it, figure by figure, paired by seed."""
    reference = _reference(results)
    verdicts: dict[str, dict[_Figure, Verdict]] = {}
    for result in results:
        if result is not reference:
            seeds = sorted(result.runs.keys() & reference.runs.keys())
            verdicts[result.method] = {
                figure: verdict(
                    [result.runs[seed][figure.name] for seed in seeds],
                    [reference.runs[seed][figure.name] for seed in seeds],
                    more_is_better=figure.more_is_better,
                )
                for figure in _measured(results)
            }
    return verdicts


def _measured(results: Sequence[MethodResult]) -> list[_Figure]:
    """Return the figures that every run of every method has."""
    return [f for f in _FIGURES if all(f.name in run for result in results for run in result.runs.values())]


def _with_error(values: Sequence[float], decimals: int) -> str:
    first, error = f"{values[0]:,.{decimals}f}", standard_error(values[1:])
    return first if math.isnan(error) else f"{first} +- {error:,.{decimals}f}"


def standard_error(values: Sequence[float]) -> float:
    """Return the error of the value with all matches, from those without `LEFT_OUT` of them; nan for fewer than two."""
    if len(values) < 2:
        return float("nan")
    return float(np.std(values, ddof=1) * ((1 - LEFT_OUT) / LEFT_OUT) ** 0.5)


def verdict(values: Sequence[float], reference: Sequence[float], *, more_is_better: bool) -> Verdict:
    """Compare the values of two methods: the first with all matches, the others by the same seeds. Raises ValueError
    for unlike numbers of values, or none."""
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
