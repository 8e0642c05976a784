"""Write the page of a comparison: its tables, and each method in the same pictures."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from colmap_ihe.dense.undistort import read_colour, read_grey
from colmap_ihe.evaluation.tables import MethodResult, sentences, tables_of
from colmap_ihe.grey.second import SecondGrey
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.pipeline import model_view
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.second_grey import pictures_of, second_of
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.report import pictures
from colmap_ihe.report.contents import Comparison, MethodFigures, Picture
from colmap_ihe.report.methods_sentence import CITATION
from colmap_ihe.report.page import render_comparison

_LONGEST, _CLOUD = 900, 640  # pixels; of a cloud fewer, for it has about one point for each


def write_comparison(
    compared: Project,
    results: Sequence[MethodResult],
    projects: Sequence[Project],
    cameras: Path,
    command: str,
) -> None:
    """Write compare/index.html of a project. `projects` of the methods, in the order of `results`; `cameras`: the model
    whose cameras served for all dense clouds; `command` makes it again. Raises `KnownError`s."""
    pair = _best_pair(projects[0], cameras)
    methods = [result.method for result in results]
    comparison = Comparison(
        title=f"{compared.root.resolve().name}: {len(results)} greys compared",
        sentences=sentences(results),
        tables=tables_of(results),
        figures=[_figures(m, p, cameras, pair) for m, p in zip(methods, projects, strict=True)],
        command=command,
        citation=CITATION,
    )
    write_bytes(compared.comparison / "index.html", render_comparison(comparison).encode())


def command_of(
    project: Path, options: Options, results: Sequence[MethodResult], **files: str | Path | None
) -> str:
    """Return the command that gives the same results again; `files`: by the name of the argument."""
    methods, seeds = ",".join(result.method for result in results), len(results[0].runs) - 1
    words = ["colmap-ihe", "compare", project.resolve().name, "--methods", methods, "--seeds", str(seeds)]
    for name, file in files.items():
        words += [f"--{name}", str(file)] if file else []
    defaults = Options().as_yaml()
    for section, values in options.as_yaml().items():
        changed = {name: v for name, v in values.items() if v != defaults[section].get(name)}
        for name, value in changed.items():
            words += ["--set", f"{section}.{name}={json.dumps(value)}"]
    return shlex.join(words)


def _best_pair(project: Project, cameras: Path) -> tuple[str, str]:
    """Return the two registered photographs with most verified matches."""
    names = model_view.ModelView(cameras).names
    matched = np.triu(model_view.verified_matches(project.database, names))
    first, second = np.unravel_index(int(np.argmax(matched)), matched.shape)
    return names[first], names[second]


def _figures(method: str, project: Project, cameras: Path, pair: tuple[str, str]) -> MethodFigures:
    second = second_of({"convert": read_record(project, "convert") or {}})
    greys = [_grey(project, name, second) for name in pair]
    chosen = pictures.shrunk(greys[0], _LONGEST)
    default = pictures.rec709(pictures.shrunk(read_colour(project.colour / pair[0]), _LONGEST))
    difference = pictures.difference(chosen, default)
    return MethodFigures(
        method,
        pictures.picture(
            chosen, f"{pair[0]} by {method}{', with what the second adds' if second else ''}", _LONGEST
        ),
        pictures.picture(difference, f"{method} less Rec.709, middle grey is none", _LONGEST),
        _matches(project, pair, greys),
        _cloud(project.workspace / "same-cameras.ply", cameras, pair[0], method),
    )


def _grey(project: Project, name: str, second: SecondGrey | None) -> pictures.U8:
    """Return a grey image, with what the second grey adds if there is one."""
    if second is None:
        return read_grey(project.grey / name)
    return pictures_of(project, second, None)(name)[0]


def _matches(project: Project, pair: tuple[str, str], greys: Sequence[pictures.U8]) -> Picture | None:
    places = model_view.places_of_matches(project.database, *pair)
    if not len(places[0]):
        return None
    first, second = (pictures.shrunk(grey, _LONGEST) for grey in greys)
    starts = places[0] * (first.shape[1] / greys[0].shape[1])
    ends = places[1] * (second.shape[1] / greys[1].shape[1])
    drawn = pictures.matches_drawn(first, second, starts, ends)
    alt = f"{len(places[0]):,} verified matches of {pair[0]} and {pair[1]}"
    return pictures.picture(drawn, alt, 2 * _LONGEST)


def _cloud(cloud: Path, cameras: Path, name: str, method: str) -> Picture | None:
    if not cloud.exists():
        return None
    pixels = model_view.cloud_as_seen(cloud, cameras, name, _CLOUD)
    return pictures.picture(pixels, f"The dense cloud of {method}, with the same cameras", _CLOUD)
