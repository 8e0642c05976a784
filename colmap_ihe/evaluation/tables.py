"""What a comparison of methods came to: its figures, its tables, and what they say."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from colmap_ihe.evaluation.pair_errors import MOVEMENTS
from colmap_ihe.evaluation.significance import LEFT_OUT, standard_error, verdict
from colmap_ihe.report.tables import Table

METHODS = ("ihe", "rec709", "rgb2gray", "green", "photoshop", "decolorize", "realtime")
PAPER = "ihe-paper"
"""IHE without the guard, to the letter of the paper."""
REFERENCE = "rec709"


@dataclass(frozen=True)
class MethodResult:
    """What was measured of one method.

    `runs`: 0 with all matches, 1 and up without some of them, by seed; each with `registered`, `points`,
    `points_over_3_views`, `mean_error_px`, `rms_px`, and where truth is known `rotation_deg`, `position_m`,
    `auc_percent`. `matching`: pairs, putative matches, inliers and their share in percent, over all pairs and by the
    camera's movement. `dense_points` with the cameras of the first method, None where dense stereo did not run.
    """

    method: str
    weights: tuple[float, ...] | None
    matching: Mapping[str, Mapping[str, Any]]
    runs: Mapping[int, Mapping[str, float]]
    dense_points: int | None


@dataclass(frozen=True)
class _Figure:
    """One that differs from seed to seed. `decimals` to show; `share`: judged in percent of the reference."""

    name: str
    title: str
    decimals: int
    more_is_better: bool


_FIGURES = (
    _Figure("registered", "oriented", 1, True),
    _Figure("rms_px", "RMS px", 3, False),
    _Figure("points", "points", 0, True),
    _Figure("points_over_3_views", "points in > 3 images", 0, True),
    _Figure("rotation_deg", "rotation error deg", 4, False),
    _Figure("position_m", "position error m", 5, False),
    _Figure("auc_percent", "AUC at 5 deg %", 2, True),
)


def tables_of(found: Sequence[MethodResult]) -> list[Table]:
    """Tables 1 to 3 of the paper, and the differences from COLMAP's default, or from the first method without it."""
    tables = [_matching(found), _reconstruction(found)]
    return [*tables, _differences(found)] if len(found) > 1 else tables


def reference_of(found: Sequence[MethodResult]) -> MethodResult:
    return next((one for one in found if one.method == REFERENCE), found[0])


def sentences(found: Sequence[MethodResult]) -> list[str]:
    """What the differences say, one method a sentence."""
    default = reference_of(found)
    said = []
    for one in found:
        if one is default:
            continue
        words = {f.title: _verdict(one, default, f) for f in _shown(found)}
        better = [name for name, word in words.items() if word == "better"]
        worse = [name for name, word in words.items() if word == "worse"]
        parts = [f"better in {', '.join(better)}"] if better else []
        parts += [f"worse in {', '.join(worse)}"] if worse else []
        if not parts:
            parts = ["no difference that this test can see"]
        said.append(f"{one.method} against {default.method}: {'; '.join(parts)}.")
    return said


def _matching(found: Sequence[MethodResult]) -> Table:
    kinds = [k for k in ("all", *MOVEMENTS) if found[0].matching[k]["pairs"]]
    columns = ["method", "weights", "putative", "inliers"]
    columns += [f"{kind}, % of putative ({found[0].matching[kind]['pairs']} pairs)" for kind in kinds]
    rows = []
    for one in found:
        weights = "-" if one.weights is None else " ".join(f"{w:.2f}" for w in one.weights)
        counts = one.matching["all"]
        shares = [_share(one.matching[kind]["efficiency_percent"]) for kind in kinds]
        rows.append([one.method, weights, f"{counts['putative']:,}", f"{counts['inliers']:,}", *shares])
    return Table("matching", "Pairwise matching efficiency: inliers of putative matches", columns, rows)


def _reconstruction(found: Sequence[MethodResult]) -> Table:
    figures = _shown(found)
    columns = ["method", *(f.title for f in figures), "dense points, same cameras"]
    rows = []
    for one in found:
        values = [
            _with_error([run[f.name] for _, run in sorted(one.runs.items())], f.decimals) for f in figures
        ]
        rows.append([one.method, *values, "-" if one.dense_points is None else f"{one.dense_points:,}"])
    runs = len(found[0].runs) - 1
    title = (
        f"Reconstruction +- standard error, from {runs} runs without {100 * LEFT_OUT:.0f} % of the matches"
    )
    return Table("reconstruction", title, columns, rows)


def _differences(found: Sequence[MethodResult]) -> Table:
    default, figures = reference_of(found), _shown(found)
    rows = []
    for one in found:
        if one is default:
            continue
        row = [one.method]
        for figure in figures:
            ours, theirs = _paired(one, default, figure)
            judged = verdict(ours, theirs, more_is_better=figure.more_is_better)
            row.append(f"{judged.difference:+,.{figure.decimals}f} ({judged.words})")
        rows.append(row)
    title = f"Differences from {default.method}, paired by seed"
    return Table("differences", title, ["method", *(f.title for f in figures)], rows)


def _shown(found: Sequence[MethodResult]) -> list[_Figure]:
    return [f for f in _FIGURES if all(f.name in run for one in found for run in one.runs.values())]


def _paired(one: MethodResult, other: MethodResult, figure: _Figure) -> tuple[list[float], list[float]]:
    seeds = sorted(one.runs.keys() & other.runs.keys())
    return [one.runs[s][figure.name] for s in seeds], [other.runs[s][figure.name] for s in seeds]


def _verdict(one: MethodResult, other: MethodResult, figure: _Figure) -> str:
    return verdict(*_paired(one, other, figure), more_is_better=figure.more_is_better).words


def _share(percent: float | None) -> str:
    return "-" if percent is None else f"{percent:.1f}"


def _with_error(values: Sequence[float], decimals: int) -> str:
    first, error = f"{values[0]:,.{decimals}f}", standard_error(values[1:])
    return first if math.isnan(error) else f"{first} +- {error:,.{decimals}f}"
