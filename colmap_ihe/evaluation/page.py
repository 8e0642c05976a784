"""The page of a comparison: its tables, and each method in the same pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from colmap_ihe.dense.undistort import read_colour, read_grey
from colmap_ihe.evaluation.tables import MethodResult, sentences, tables_of
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.pipeline import model_view as shown
from colmap_ihe.pipeline.page import CITATION
from colmap_ihe.project.folder import Project
from colmap_ihe.report import pictures
from colmap_ihe.report.contents import Comparison, MethodFigures, Picture
from colmap_ihe.report.page import render_comparison

_LONGEST, _CLOUD = 900, 640  # pixels; of a cloud fewer, for it has about one point for each


def write_comparison(
    place: Project, found: Sequence[MethodResult], projects: Sequence[Project], cameras: Path
) -> Path:
    """Writes compare/index.html of a project. `projects` of the methods, in the order of `found`; `cameras`: the model
    whose cameras served for all dense clouds. Raises `KnownError`s."""
    first, second = _best_pair(projects[0], cameras)
    methods = [one.method for one in found]
    comparison = Comparison(
        title=f"{place.root.resolve().name}: {len(found)} greys compared",
        sentences=sentences(found),
        tables=tables_of(found),
        figures=[_figures(m, p, cameras, first, second) for m, p in zip(methods, projects, strict=True)],
        command=f"colmap-ihe compare {place.root.name} --methods {','.join(methods)}",
        citation=CITATION,
    )
    page = place.comparison / "index.html"
    write_bytes(page, render_comparison(comparison).encode())
    return page


def _best_pair(project: Project, cameras: Path) -> tuple[str, str]:
    """Of the photographs with a place in the model, the two with most verified matches."""
    names = shown.ModelView(cameras).names
    matched = np.triu(shown.verified_matches(project.database, names))
    one, other = np.unravel_index(int(np.argmax(matched)), matched.shape)
    return names[one], names[other]


def _figures(method: str, project: Project, cameras: Path, first: str, second: str) -> MethodFigures:
    whole = [read_grey(project.grey / name) for name in (first, second)]
    one, other = (pictures.shrunk(grey, _LONGEST) for grey in whole)
    default = pictures.rec709(pictures.shrunk(read_colour(project.colour / first), _LONGEST))
    cloud = project.workspace / "same-cameras.ply"
    return MethodFigures(
        method,
        pictures.picture(one, f"{first} by {method}", _LONGEST),
        pictures.picture(
            pictures.difference(one, default), f"{method} less Rec.709, middle grey is none", _LONGEST
        ),
        _matches(project, first, second, one, other, whole[0].shape[1], whole[1].shape[1]),
        _cloud(cloud, cameras, first, method) if cloud.exists() else None,
    )


def _matches(
    project: Project,
    first: str,
    second: str,
    one: pictures.U8,
    other: pictures.U8,
    first_width: int,
    second_width: int,
) -> Picture | None:
    ones, others = shown.places_of_matches(project.database, first, second)
    if not len(ones):
        return None
    ones, others = ones * (one.shape[1] / first_width), others * (other.shape[1] / second_width)
    drawn = pictures.matches_drawn(one, other, ones, others)
    return pictures.picture(drawn, f"{len(ones):,} verified matches of {first} and {second}", 2 * _LONGEST)


def _cloud(cloud: Path, cameras: Path, name: str, method: str) -> Picture:
    seen = shown.cloud_as_seen(cloud, cameras, name, _CLOUD)
    return pictures.picture(seen, f"The dense cloud of {method}, with the same cameras", _CLOUD)
