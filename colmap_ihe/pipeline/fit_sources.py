"""What a fit over several campaigns is of: photographs that are read, and histograms of those that were read before."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.fit.histogram_file import SUFFIX, StoredCounts, read_stored
from colmap_ihe.photographs.discover import Capture, captures_of_files, discover
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import DevelopOptions
from colmap_ihe.project.options_file import load_options


@dataclass(frozen=True)
class Source:
    """Photographs that are developed alike."""

    captures: Sequence[Capture]
    develop: DevelopOptions
    calibration: Path | None
    ignored: tuple[str, ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)


@dataclass
class Campaigns:
    sources: list[Source] = field(default_factory=list)
    stored: list[StoredCounts] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def campaigns_of(paths: Sequence[Path], develop: DevelopOptions, calibration: Path | None) -> Campaigns:
    """Of each path what it holds: a histogram; a project's histogram, or if it has none that is true its photographs,
    developed as the project has it; a folder of photographs; photographs, these as given. Raises `KnownError`s."""
    found = Campaigns()
    photographs = [p for p in paths if not p.is_dir() and p.suffix.lower() != SUFFIX]
    if photographs:
        found.sources.append(Source(captures_of_files(photographs), develop, calibration))
    for path in dict.fromkeys(paths):
        if path in photographs:
            continue
        if not path.is_dir():
            found.stored.append(read_stored(path))
        elif is_project(path):
            _add_project(found, path)
        else:
            discovery = discover(path)
            more = (discovery.ignored, discovery.refused)
            found.sources.append(Source(discovery.captures, develop, calibration, *more))
    if len(found.sources) > 1:  # names are told apart by their folder then
        found.sources = [replace(s, captures=[_named(c) for c in s.captures]) for s in found.sources]
    return found


def is_project(path: Path) -> bool:
    """Whether a folder is a project, and not one of photographs: it has been run, or has options of its own."""
    return (path / "records").is_dir() or ((path / "images").is_dir() and (path / "project.yaml").is_file())


def _add_project(found: Campaigns, root: Path) -> None:
    project = Project.at(root)
    options = load_options(project.options_file)
    why = "it was not fitted yet"
    if project.histogram_file.is_file():
        fit = next(stage for stage in status(root, options) if stage.name == "fit")
        if fit.state == "done":
            found.stored.append(read_stored(project.histogram_file))
            return
        why = fit.why or "its fit is not finished"
    found.notes.append(f"{root}: no histogram that is true ({why}), so its photographs are read")
    discovery = discover(project.images)
    calibration = project.calibration if project.calibration.is_dir() else None
    more = (discovery.ignored, discovery.refused)
    found.sources.append(Source(discovery.captures, options.develop, calibration, *more))


def _named(capture: Capture) -> Capture:
    return replace(capture, name=capture.path.as_posix())


def warnings_of(
    gathered: Iterable[SetCounts], developments: Iterable[tuple[str, Mapping[str, Any]]]
) -> list[str]:
    """What is odd about sets that were pooled: photographs that are in several, and several ways of development."""
    twice = sum(n - 1 for one in gathered for n in Counter(one.keys).values())
    words = [f"{twice} photographs are in the set more than once, and count so"] if twice else []
    first, *others = list(developments) or [("", {})]
    for source, development in others:
        if development != first[1]:
            unlike = sorted(n for n in {*first[1], *development} if first[1].get(n) != development.get(n))
            words.append(
                f"{source}: developed in another way than {first[0]} ({', '.join(unlike)}): the same colour may be"
                " another in it"
            )
    return words
