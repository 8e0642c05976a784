"""Try greys on some of the set's own photographs: how many matches each will bring COLMAP's mapper.

Detail, noise and compression differ from set to set, so no rule knows beforehand which grey matches best; a
measurement does. It takes whole photographs, with COLMAP's own features at its thresholds, its largest size of an
image and its largest number of features: a grey that shows a few per cent fewer features loses them here as it will
in the reconstruction, which windows with equal numbers of features cannot see. A grey is chosen on some pairs, and
others that had no part in it confirm the choice. The gain over Rec.709, COLMAP's default, comes with its standard
error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Literal

from colmap_ihe.colmap.native import quiet
from colmap_ihe.colmap.part_databases import task_folder
from colmap_ihe.fit.overlaps import LOOKED_AT, PAIRS, Overlap, Plan, find_overlaps, plan_of
from colmap_ihe.fit.trial_bench import Bench, Trial
from colmap_ihe.fit.trial_result import REFERENCE, TrialResult, leader_of, summed_up
from colmap_ihe.grey.weights import Grey
from colmap_ihe.machine.executor import threads_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.decode import encoding_of
from colmap_ihe.photographs.discover import Capture

Purpose = Literal["choose", "win", "report"]
"""To choose one; to see whether another one wins against the reference, which needs no confirmation where the
reference is better on the first pair; or to report on all pairs alike, where nothing is chosen."""
_LARGE = 2 * LOOKED_AT
"""Photographs of a set in which the trial may take nine: in a smaller one they would be a large share of all."""


def measure(
    captures: Sequence[Capture],
    greys: Mapping[str, Grey],
    executor: Executor,
    progress: Progress,
    trial: Trial,
    purpose: Purpose = "choose",
) -> TrialResult:
    """Return verified matches of each of `greys` on some pairs of photographs, and of the best on the others.

    One of `greys` is named "rec709", and all are for one encoding; captures of another are passed over. The best is
    that of most matches on the first pairs, and the pairs in `held_out` confirm it. The same photographs give the same
    answer. Photographs that cannot be read are passed over; where there are fewer than `PAIRS` pairs, nothing is
    chosen, and the result says why, with what they gave. Raises ValueError for greys as above, `NativeError`,
    `Cancelled`.
    """
    encodings = {g.encoding for g in greys.values()}
    if REFERENCE not in greys or len(encodings) != 1:
        raise ValueError(f"{sorted(greys)=} {encodings=}, expected {REFERENCE} among them and one encoding")
    members = [c for c in captures if encoding_of(c) in encodings]
    if len(members) < 2:
        return TrialResult(reason=f"a pair takes two photographs, and there are {len(members)} of this kind")
    with quiet(), threads_of(executor) as threads:
        overlaps, reason = find_overlaps(members, threads, progress)
        if not overlaps:
            return TrialResult(reason=reason)
        with task_folder() as folder:
            bench = Bench(threads, progress, trial, folder)
            return _tried(bench, overlaps, greys, len(members) >= _LARGE, purpose)


def _tried(
    bench: Bench, overlaps: Sequence[Overlap], greys: Mapping[str, Grey], is_large: bool, purpose: Purpose
) -> TrialResult:
    """Try greys on pairs whose photographs can be read in full: with each that cannot, all is planned anew."""
    while True:
        broken = set(bench.unreadable)
        kept = [o for o in overlaps if not broken & set(o.names)]
        if not kept:
            return TrialResult(reason="the photographs that overlap cannot be read in full")
        result = _planned(bench, plan_of(kept, is_large), greys, purpose)
        if bench.unreadable == broken:
            return result


def _planned(bench: Bench, plan: Plan, greys: Mapping[str, Grey], purpose: Purpose) -> TrialResult:
    every = (*plan.choosing, *plan.confirming)
    if not plan.is_whole or purpose == "report":
        return replace(_measured(bench, every, greys), reason="" if plan.is_whole else _too_few(len(every)))
    if purpose == "win":
        first = _measured(bench, plan.choosing[:1], greys)
        if leader_of(first) == REFERENCE:
            return first
    chosen_on = _measured(bench, plan.choosing, greys)
    leader = leader_of(chosen_on)
    if leader == REFERENCE and purpose == "win":
        return chosen_on
    finalists = {REFERENCE: greys[REFERENCE], leader: greys[leader]} if len(greys) > 2 else greys
    return replace(chosen_on, held_out=_measured(bench, plan.confirming, finalists))


def _measured(bench: Bench, pairs: Sequence[Overlap], greys: Mapping[str, Grey]) -> TrialResult:
    """Return what the greys give on pairs of which both photographs can be read."""
    captures = {c.name: c for pair in pairs for c in (pair.first, pair.second)}
    bench.look_at(captures.values(), list(greys.values()))
    readable = [pair for pair in pairs if not bench.unreadable & set(pair.names)]
    return summed_up([pair.names for pair in readable], list(greys), bench.counts(readable, greys))


def _too_few(pairs: int) -> str:
    return f"that takes {PAIRS} pairs of photographs that overlap, and there {'is' if pairs == 1 else 'are'} {pairs}"
