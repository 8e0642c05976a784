"""Look for what the grey of a project does not show, and fit the second grey to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from colmap_ihe.colmap.second_features import Pictures
from colmap_ihe.dense.undistort import read_colour, read_grey
from colmap_ihe.grey.second import F32, U8, SecondGrey
from colmap_ihe.grey.second_fit import Blocks, Noise, blocks_of, fit_second, lost_places
from colmap_ihe.machine.executor import in_order, threads_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.pipeline.stage import Record, RunContext, StrictModel
from colmap_ihe.project.folder import Project
from colmap_ihe.report import pictures
from colmap_ihe.report.contents import LostColour
from colmap_ihe.report.tables import lost_in_words, second_in_words

UNIT = "photographs judged"
"""What is counted of the look for what the grey does not show."""
_MOST = 200  # photographs that are looked at, spread over the set
_SHOWN = 0.0005  # of the places with detail: where less is lost, there is nothing to see
_PICTURE = 1000  # pixels
_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class _NoiseRecord(StrictModel):
    colours: Annotated[Sequence[float], Field(min_length=6, max_length=6)]
    grey: Annotated[float, Field(gt=0)]
    rec709: Annotated[float, Field(gt=0)]


class SecondGreyRecord(StrictModel):
    """Hold the second grey, if there is one, and the shares of the places with detail that the first and COLMAP's
    default lose: of the set, of the part of it that the second shows, and of each photograph that was looked at, by the
    name of its grey."""

    lost: _Share
    lost_by_rec709: _Share
    regained: _Share
    by_photograph: dict[str, _Share]
    noise: _NoiseRecord
    second: dict[str, Any] | None


def fit_second_grey(
    run: RunContext, grey_names: Sequence[str], progress: Progress
) -> SecondGreyRecord | None:
    """Fit the second grey as `fit.second` says, from the grey images and their colour twins; None if it is to be
    none."""
    asked, project = run.options.fit.second, run.project
    if asked == "none":
        return None
    step = max(1, -(-len(grey_names) // _MOST))
    names = list(grey_names)[::step]
    progress.start(len(names), UNIT)

    def measured(name: str) -> Blocks:
        return blocks_of(read_grey(project.grey / name), read_colour(project.colour / name))

    photographs = []
    with threads_of(run.executor) as pool:
        for blocks in in_order(pool, measured, names, progress=progress):
            photographs.append(blocks)
            progress.advance()
    fit = fit_second(photographs, None if asked == "auto" else asked)
    return SecondGreyRecord(
        lost=round(fit.lost, 6),
        lost_by_rec709=round(fit.lost_by_rec709, 6),
        regained=round(fit.regained, 6),
        by_photograph={name: round(share, 6) for name, share in zip(names, fit.by_photograph, strict=True)},
        noise=_NoiseRecord(**asdict(fit.noise)),
        second=None if fit.second is None else asdict(fit.second),
    )


def pictures_of(project: Project, second: SecondGrey, masks: Path | None) -> Pictures:
    """Return a function that gives of a grey image, by name, what the second grey makes of it, as
    `add_second_features` asks for it."""

    def picture(name: str) -> tuple[U8, F32]:
        combined, shares = second.combined(read_grey(project.grey / name), read_colour(project.colour / name))
        if masks is not None and (file := masks / f"{name}.png").is_file():
            shares = np.where(read_grey(file) > 0, shares, 0).astype(np.float32)
        return combined, shares

    return picture


def second_of(records: Mapping[str, Record]) -> SecondGrey | None:
    """Return the second grey of a project that is converted, if it has one."""
    record = records["convert"].get("second")
    return SecondGrey(**record["second"]) if record and record["second"] else None


def lost_colour(
    project: Project, records: Mapping[str, Record], summary: Mapping[str, Any], compared: bool
) -> LostColour | None:
    """Return what the page shows of what the grey loses, and if `compared`, COLMAP's default; None where nobody looked.
    Raises `ProjectError`."""
    record = records["convert"].get("second")
    if record is None:
        return None
    second = second_of(records)
    words = lost_in_words(summary, compared)
    if second is not None:
        words += f" The second grey is {second_in_words(summary['second_grey'])}."
    worst = max(record["by_photograph"], key=lambda name: record["by_photograph"][name], default="")
    if not worst or record["by_photograph"][worst] < _SHOWN:
        return LostColour(words)
    grey, colour = read_grey(project.grey / worst), read_colour(project.colour / worst)
    noise = Noise(**record["noise"])
    names = {grey: name for name, grey in records["convert"]["grey"].items()}
    small = pictures.shrunk(colour, _PICTURE)
    marked = [
        pictures.picture(pictures.marked(small, places), f"{names[worst]}, {which} marked", _PICTURE)
        for places, which in zip(
            lost_places(grey, colour, noise), ("what the grey loses", "what Rec.709 loses"), strict=True
        )
    ]
    default = marked[1] if compared else None
    shown = None
    if second is not None:
        combined, _ = second.combined(grey, colour)
        shown = pictures.picture(combined, f"{names[worst]} with the second grey", _PICTURE)
    return LostColour(words, names[worst], marked[0], default, shown)
