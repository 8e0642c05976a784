"""What the commands do besides `reconstruct` and `status`: plain values in, plain values out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from colmap_ihe.errors import WeightsError
from colmap_ihe.fit import given_weights as misfit
from colmap_ihe.fit.fit_set import Fit, fit_captures
from colmap_ihe.fit.histogram_file import SUFFIX, StoredCounts, write_stored
from colmap_ihe.fit.weights_file import write_weights
from colmap_ihe.grey.weights import Grey, Weights
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut, refused
from colmap_ihe.photographs.recipes import prepared_set
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline import fit_sources as campaigns
from colmap_ihe.pipeline.fit_sources import campaigns_of
from colmap_ihe.pipeline.warnings import photographs as oddities
from colmap_ihe.project.options import DevelopOptions, FitOptions


def fit_files(
    paths: Sequence[Path],
    options: FitOptions | None = None,
    *,
    output: Path | None = None,
    histogram: Path | None = None,
    weights: Grey | None = None,
    develop: DevelopOptions | None = None,
    calibration: Path | None = None,
    strict: bool = False,
    progress: RunProgress = SILENT,
) -> tuple[Grey, LeftOut]:
    """The weights of a set of projects, histograms, folders and files, written to `output` if given; of the larger
    part where the set mixes RAW and gamma-coded photographs. What was counted is written to `histogram`, which is
    one to name in a later fit. With `weights` nothing is fitted: the owner is told whether they fit the set. Returns
    them and what was left out. Raises `KnownError`s."""
    _require_suffix(output, (".yaml", ".yml"), "-o weights.yaml")
    _require_suffix(histogram, (SUFFIX,), f"--histogram all{SUFFIX}")
    options, develop = options or FitOptions(), develop or DevelopOptions()
    found = campaigns_of(paths, develop, calibration)
    for text in found.notes:
        progress.warn(text)
    surveyed: list[Surveyed] = []
    unreadable: LeftOut = {}
    for source in found.sources:
        unreadable |= refused(source, strict)
    with local_executor() as executor, ExitStack() as stack:
        for source in found.sources:
            how = (source.captures, source.develop, source.calibration, executor, progress)
            prepared = stack.enter_context(prepared_set(*how, strict=strict))
            surveyed += prepared.surveyed
            unreadable |= prepared.left_out
        ignored = tuple(name for source in found.sources for name in source.ignored)
        for text in oddities.warnings_of(surveyed, ignored) if surveyed else ():
            progress.warn(text)
        usable = [s.capture for s in surveyed]
        with progress.stage("fit") as stage_progress:
            fit = fit_captures(
                usable, options, executor, stage_progress, strict=strict, stored=found.stored, given=weights
            )
    developments: list[tuple[str, Mapping[str, Any]]] = [(s.source, s.development) for s in found.stored]
    developments += [
        (str(s.captures[0].path.parent), s.develop.model_dump(mode="json")) for s in found.sources
    ]
    for text in _warnings_of(fit, usable, weights, options, developments):
        progress.warn(text)
    if histogram is not None:
        write_stored(histogram, StoredCounts(fit.gathered, options.sample, developments[0][1]))
    if output is not None:
        write_weights(output, fit.main)
    return fit.main, unreadable | fit.left_out


def _require_suffix(file: Path | None, suffixes: Sequence[str], example: str) -> None:
    if file is not None and file.suffix.lower() not in suffixes:
        raise WeightsError(f"{file}: wanted a name that ends in {suffixes[0]}", hint=f"as in {example}")


def _warnings_of(
    fit: Fit,
    usable: Sequence[Capture],
    given: Grey | None,
    options: FitOptions,
    developments: Sequence[tuple[str, Mapping[str, Any]]],
) -> list[str]:
    words = campaigns.warnings_of(fit.gathered.values(), developments)
    if len(fit.weights) > 1:
        words.append(
            "the set mixes RAW and gamma-coded photographs: these are the weights of the larger part"
        )
    if isinstance(given, Weights):
        return words + misfit.warnings_of(given, fit.gathered[given.encoding], options)
    return words + (oddities.fit_warnings(usable, fit.weights.values()) if usable else [])
