"""Fit one grey to projects, histograms, folders and photographs together, without COLMAP."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from colmap_ihe.errors import WeightsError
from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.fit.fit_set import Fit, fit_captures
from colmap_ihe.fit.histogram_file import SUFFIX, StoredCounts, read_stored, write_stored
from colmap_ihe.fit.trial_result import ChosenGrey
from colmap_ihe.fit.weights_file import warnings_of, write_weights
from colmap_ihe.grey.weights import Grey, Weights
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.discover import Capture, captures_of_files, shot_notes
from colmap_ihe.photographs.each import LeftOut, refused
from colmap_ihe.photographs.readable import find_photographs, with_readable_halves
from colmap_ihe.photographs.recipes import prepared_set
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.run_stages import warn_of
from colmap_ihe.pipeline.status import status
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.pipeline.warnings.files import depth_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import DevelopOptions, FitOptions
from colmap_ihe.project.options_file import load_options


@dataclass(frozen=True)
class _Source:
    """Hold photographs that are developed alike."""

    captures: Sequence[Capture]
    develop: DevelopOptions
    calibration: Path | None
    ignored: tuple[str, ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass
class _Campaigns:
    """Hold photographs to be read, histograms of those that were read before, and notes for the user."""

    sources: list[_Source] = field(default_factory=list)
    stored: list[StoredCounts] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class FilesFit:
    """Hold the grey of the larger part of a set, what was left out with the reason, and what was tried on pairs of its
    photographs, if anything."""

    grey: Grey
    left_out: LeftOut
    tried: ChosenGrey | None


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
) -> FilesFit:
    """Fit the weights of a set of projects, histograms, folders and files, and write them to `output` if given; those
    of the larger part where the set mixes RAW and gamma-coded photographs. What was counted is written to `histogram`,
    which can be named in a later fit. With `weights` nothing is fitted: the user is told whether they fit the set.
    Raises `KnownError`s."""
    _require_suffix(output, (".yaml", ".yml"), "-o weights.yaml")
    _require_suffix(histogram, (SUFFIX,), f"--histogram all{SUFFIX}")
    options, develop = options or FitOptions(), develop or DevelopOptions()
    campaigns = _campaigns_of(paths, develop, calibration)
    warn_of(campaigns.notes, progress)
    surveyed: list[Surveyed] = []
    unreadable: LeftOut = {}
    with local_executor() as executor, ExitStack() as stack:
        for source in campaigns.sources:
            how = (source.captures, source.develop, source.calibration, executor, progress)
            refused_files = refused(source.refused, strict)
            prepared = stack.enter_context(prepared_set(*how, strict=strict, refused=refused_files))
            surveyed += prepared.surveyed
            unreadable |= prepared.left_out
        ignored = tuple(name for source in campaigns.sources for name in source.ignored)
        notes = tuple(note for source in campaigns.sources for note in source.notes)
        warn_of(set_warnings.warnings_of(surveyed, ignored, notes) if surveyed else (), progress)
        usable = [s.capture for s in surveyed]
        with progress.stage("fit") as stage_progress:
            fit = fit_captures(
                usable,
                options,
                executor,
                stage_progress,
                strict=strict,
                stored=campaigns.stored,
                given=weights,
            )
    developments: list[tuple[str, Mapping[str, Any]]] = [(s.source, s.development) for s in campaigns.stored]
    developments += [
        (str(s.captures[0].path.parent), s.develop.model_dump(mode="json")) for s in campaigns.sources
    ]
    warn_of(_warnings_of(fit, usable, weights, options, developments), progress)
    if histogram is not None:
        write_stored(histogram, StoredCounts(fit.gathered, options.sample, developments[0][1]))
    if output is not None:
        write_weights(output, fit.main)
    return FilesFit(fit.main, unreadable | fit.left_out, fit.tried.get(fit.main.encoding))


def is_project(path: Path) -> bool:
    """Tell a project from a folder of photographs: it has been run, or has options of its own."""
    return (path / "records").is_dir() or ((path / "images").is_dir() and (path / "project.yaml").is_file())


def _campaigns_of(paths: Sequence[Path], develop: DevelopOptions, calibration: Path | None) -> _Campaigns:
    """Return what each path holds: a histogram; a project's histogram, or if it has none that is true its photographs,
    developed as the project has it; a folder of photographs; photographs, these as given. Raises `KnownError`s."""
    campaigns = _Campaigns()
    photographs = [p for p in paths if not p.is_dir() and p.suffix.lower() != SUFFIX]
    if photographs:
        found = captures_of_files(photographs)
        captures, notes = with_readable_halves(found)
        campaigns.sources.append(_Source(captures, develop, calibration, notes=(*shot_notes(found), *notes)))
    for path in dict.fromkeys(paths):
        if path in photographs:
            continue
        if not path.is_dir():
            campaigns.stored.append(read_stored(path))
        elif is_project(path):
            _add_project(campaigns, path)
        else:
            campaigns.sources.append(_source_of(path, develop, calibration))
    if len(campaigns.sources) > 1:  # names are told apart by their folder then
        campaigns.sources = [
            replace(s, captures=[replace(c, name=c.path.as_posix()) for c in s.captures])
            for s in campaigns.sources
        ]
    return campaigns


def _add_project(campaigns: _Campaigns, root: Path) -> None:
    project = Project.at(root)
    options = load_options(project.options_file)
    why = "it was not fitted yet"
    if project.histogram_file.is_file():
        fit = next(stage for stage in status(root, options) if stage.name == "fit")
        if fit.state == "done":
            campaigns.stored.append(read_stored(project.histogram_file))
            return
        why = fit.why or "its fit is not finished"
    campaigns.notes.append(f"{root}: no histogram that is true ({why}), so its photographs are read")
    calibration = project.calibration if project.calibration.is_dir() else None
    campaigns.sources.append(_source_of(project.images, options.develop, calibration))


def _source_of(folder: Path, develop: DevelopOptions, calibration: Path | None) -> _Source:
    discovery = find_photographs(folder)
    return _Source(
        discovery.captures, develop, calibration, discovery.ignored, discovery.refused, discovery.notes
    )


def _require_suffix(file: Path | None, suffixes: Sequence[str], example: str) -> None:
    if file is not None and file.suffix.lower() not in suffixes:
        raise WeightsError(f"{file}: expected a name that ends in {suffixes[0]}", hint=f"as in {example}")


def _warnings_of(
    fit: Fit,
    usable: Sequence[Capture],
    given: Grey | None,
    options: FitOptions,
    developments: Sequence[tuple[str, Mapping[str, Any]]],
) -> list[str]:
    warnings = _pooling_warnings(fit.gathered.values(), developments)
    warnings += depth_warnings(usable, fit.gathered)
    if len(fit.weights) > 1:
        warnings.append(
            "the set mixes RAW and gamma-coded photographs: these are the weights of the larger part"
        )
    if isinstance(given, Weights):
        return warnings + warnings_of(given, fit.gathered[given.encoding], options)
    return warnings + (set_warnings.fit_warnings(usable, fit.weights.values()) if usable else [])


def _pooling_warnings(
    counts: Iterable[SetCounts], developments: Sequence[tuple[str, Mapping[str, Any]]]
) -> list[str]:
    """Warn of photographs that are in several sets, and of several ways of development."""
    twice = sum(n - 1 for each in counts for n in Counter(each.keys).values())
    warnings = [f"{twice} photographs are in the set more than once, and count so"] if twice else []
    first, *others = developments or [("", {})]
    for source, development in others:
        if development != first[1]:
            unlike = sorted(n for n in {*first[1], *development} if first[1].get(n) != development.get(n))
            warnings.append(
                f"{source}: developed in another way than {first[0]} ({', '.join(unlike)}): the same colour may be"
                " another in it"
            )
    return warnings
