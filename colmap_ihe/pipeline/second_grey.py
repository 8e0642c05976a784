"""Look for what the grey of a project does not show, and fit the second grey to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from colmap_ihe.colmap.second_features import Pictures
from colmap_ihe.dense.undistort import read_colour, read_grey
from colmap_ihe.grey.second import F32, U8, SecondGrey
from colmap_ihe.grey.second_fit import Blocks, blocks_of, fit_second
from colmap_ihe.machine.executor import in_order, threads_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.pipeline.stage import Record, RunContext, StrictModel
from colmap_ihe.project.folder import Project

_MOST = 200  # photographs that are looked at, spread over the set
_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class SecondGreyRecord(StrictModel):
    """Hold the second grey, if there is one, and the shares of the places with detail that the first loses: of the set,
    of the part of it that the second shows, and of each photograph that was looked at, by the name of its grey."""

    lost: _Share
    regained: _Share
    by_photograph: dict[str, _Share]
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
    progress.start(len(names), "photographs, for colours that the grey does not show")

    def measured(name: str) -> Blocks:
        return blocks_of(read_grey(project.grey / name), read_colour(project.colour / name))

    photographs = []
    with threads_of(run.executor) as pool:
        for blocks in in_order(pool, measured, names, progress=progress):
            photographs.append(blocks)
            progress.advance()
    fit = fit_second(photographs, None if asked == "auto" else asked)
    by_photograph = {name: round(share, 6) for name, share in zip(names, fit.by_photograph, strict=True)}
    second = None if fit.second is None else fit.second.as_dict()
    return SecondGreyRecord(
        lost=round(fit.lost, 6), regained=round(fit.regained, 6), by_photograph=by_photograph, second=second
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
    found = records["convert"].get("second")
    return SecondGrey(**found["second"]) if found and found["second"] else None
