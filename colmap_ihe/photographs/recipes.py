"""Recipes to develop each photograph of the set, from the options, the calibration frames and what EXIF says."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.executor import threads_of
from colmap_ihe.machine.progress import Progress, RunProgress
from colmap_ihe.machine.scratch import scratch_folder
from colmap_ihe.machine.words import listed
from colmap_ihe.photographs.colour_balance import balance_gains
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut
from colmap_ihe.photographs.exposure import exposure_gains
from colmap_ihe.photographs.raw.calibration import BAD_PIXELS, Master, matched, read_bad_pixels, shot_of
from colmap_ihe.photographs.raw.calibration_masters import (
    bad_pixels_of_set,
    camera_of,
    masters_of,
    save_bad_pixels,
    union_of,
)
from colmap_ihe.photographs.survey import Surveyed, survey
from colmap_ihe.project.options import CamerasOptions, DevelopOptions
from colmap_ihe.project.recipe import Recipe


@dataclass
class Recipes:
    """Hold `surveyed`: the photographs with their recipes. `steps`: what is done to those of each kind of camera, in
    words, for the record; `warnings` what its owner should know; `left_out` those that cannot be used."""

    surveyed: list[Surveyed]
    steps: dict[str, list[str]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    left_out: LeftOut = field(default_factory=dict)


def with_recipes(
    surveyed: Sequence[Surveyed],
    options: DevelopOptions,
    calibration: Path | None,
    store: Path,
    executor: Executor,
    progress: Progress,
    *,
    strict: bool,
) -> Recipes:
    """Give every photograph its recipe. `calibration`: the user's folder of frames, if there is one; what is made of
    them is kept in `store`. Raises `ProjectError` for a folder that cannot be used, `PhotographError` for a broken
    frame if strict."""
    names_by_warning: dict[str, list[str]] = defaultdict(list)
    masters: list[Master] = []
    listed = ""
    if calibration is not None and calibration.is_dir():
        with threads_of(executor) as threads:  # frames are summed here
            masters = masters_of(
                calibration, store, threads, progress, strict, lambda text: names_by_warning[text].append("")
            )
        if (calibration / BAD_PIXELS).is_file():
            listed = save_bad_pixels(store, read_bad_pixels(calibration / BAD_PIXELS))
    plain = Recipe(
        demosaic=options.demosaic, green_equilibrium=options.green_equilibrium, denoise=options.denoise
    )
    balances = _balances_of(surveyed)
    bad_pixels: dict[tuple[str, ...], str] = {}
    if options.find_bad_pixels:
        bad_pixels = bad_pixels_of_set(surveyed, store, executor, progress, names_by_warning)
    result = []
    for photograph in surveyed:
        recipe = plain if photograph.capture.kind == "raw" else Recipe(denoise=options.denoise)
        balance = balances.get(_model_of(photograph), ()) if photograph.white_balance else ()
        recipe = replace(recipe, white_balance=balance, linear=photograph.capture.recipe.linear)
        if photograph.sensor in ("bayer", "x-trans", "mosaic", "monochrome"):
            shot = shot_of(photograph.metadata, photograph.width, photograph.height)
            messages: list[str] = []
            recipe, shown = matched(shot, masters, recipe, messages.append)
            for text in messages:
                names_by_warning[text].append(photograph.capture.name)
            known = [*shown, listed, bad_pixels.get(camera_of(photograph), "")]
            recipe = replace(recipe, bad_pixels=union_of(known, store))
        result.append(_with(photograph, recipe))
    if options.exposure == "normalise":
        result, messages = _normalised(result)
        for text in messages:
            names_by_warning[text].append("")
    if options.balance:
        gains = balance_gains([s.capture for s in result], executor, progress)
        result = [_scaled(s, gains[s.capture.name]) for s in result]
    warnings = [f"{text}: {_some(names)}" if any(names) else text for text, names in names_by_warning.items()]
    return Recipes(result, _steps(result), warnings)


def _balances_of(surveyed: Sequence[Surveyed]) -> dict[tuple[str, str], tuple[float, ...]]:
    """Return one white balance for each model of camera, the median of its shots: automatic balance wanders with what
    a photograph shows, and the same surface would have another colour in each twin."""
    shots: dict[tuple[str, str], list[tuple[float, ...]]] = defaultdict(list)
    for photograph in surveyed:
        if photograph.white_balance:
            shots[_model_of(photograph)].append(photograph.white_balance)
    return {
        model: tuple(np.round(np.median(balances, axis=0), 6).tolist()) for model, balances in shots.items()
    }


def _model_of(photograph: Surveyed) -> tuple[str, str]:
    return photograph.metadata.make, photograph.metadata.model


def _with(photograph: Surveyed, recipe: Recipe) -> Surveyed:
    return replace(photograph, capture=replace(photograph.capture, recipe=recipe))


def _normalised(surveyed: list[Surveyed]) -> tuple[list[Surveyed], list[str]]:
    """Return RAW as if all were exposed alike; the exposure of others is in their tone curve, which nobody knows."""
    raw = {s.capture.name: s.metadata for s in surveyed if s.capture.kind == "raw"}
    gains, warnings = exposure_gains(raw)
    others = len(surveyed) - len(raw)
    if others:
        warnings.append(f"exposure is normalised of RAW only, not of {others} other photographs")
    return [_scaled(s, (gains.get(s.capture.name, 1.0),) * 3) for s in surveyed], warnings


def _scaled(photograph: Surveyed, gains: tuple[float, float, float]) -> Surveyed:
    recipe = photograph.capture.recipe
    red, green, blue = (a * b for a, b in zip(recipe.gains, gains, strict=True))
    return _with(photograph, replace(recipe, gains=(red, green, blue)))


def _steps(surveyed: Sequence[Surveyed]) -> dict[str, list[str]]:
    """Return what is done to the photographs of each kind of sensor and recipe, with what does not apply left out."""
    kinds: dict[str, list[str]] = {}
    for photograph in surveyed:
        if photograph.capture.kind != "raw":
            continue
        metadata, recipe = photograph.metadata, photograph.capture.recipe
        steps = list(_steps_of(recipe, photograph.sensor))
        label = f"{metadata.make} {metadata.model}".strip() or "unknown camera"
        name = f"{label}, {photograph.sensor}"
        number = 1
        while kinds.setdefault(name, steps) != steps:
            number += 1
            name = f"{label}, {photograph.sensor} ({number})"
    return kinds


def _steps_of(recipe: Recipe, sensor: str) -> Iterator[str]:
    if recipe.bias and recipe.dark:
        yield "bias frame, and dark frame scaled to the exposure"
    else:
        yield "dark frame" if recipe.dark else "bias frame" if recipe.bias else "black level"
    if recipe.flat:
        yield "flat field"
    if recipe.bad_pixels:
        yield f"{len(np.load(recipe.bad_pixels, allow_pickle=False))} bad pixels"
    if sensor == "bayer" and recipe.green_equilibrium:
        yield "green equilibrium"
    if sensor not in ("demosaiced", "monochrome"):
        yield f"demosaicing ({recipe.demosaic})"
    if recipe.gains != (1, 1, 1):
        yield "exposure or colour balance"
    if recipe.denoise:
        yield f"denoising ({recipe.denoise:g})"


def _some(names: Sequence[str]) -> str:
    return listed([name for name in names if name])


@contextmanager
def prepared_set(
    captures: Sequence[Capture],
    options: DevelopOptions | None,
    calibration: Path | None,
    executor: Executor,
    progress: RunProgress,
    *,
    strict: bool,
    cameras: CamerasOptions | None = None,
    refused: LeftOut | None = None,
) -> Iterator[Recipes]:
    """Give photographs surveyed and with their recipes, for work outside of a project: the means of calibration frames
    last as long as the context. Raises as `with_recipes`, and `ProjectError` for a `calibration` that is no folder."""
    if calibration is not None and not calibration.is_dir():
        raise ProjectError(
            f"{calibration}: no such folder of calibration frames",
            hint="name a folder with bias/, darks/, flats/ or bad-pixels.txt in it",
        )
    with scratch_folder() as store:
        with progress.stage("captures") as stage_progress:
            surveyed, left_out = survey(
                captures, executor, stage_progress, strict=strict, cameras=cameras, refused=refused
            )
            how = (options or DevelopOptions(), calibration, store, executor, stage_progress)
            recipes = with_recipes(surveyed, *how, strict=strict)
        for text in recipes.warnings:
            progress.warn(text)
        yield replace(recipes, left_out=left_out)


def recipe_notes(surveyed: Sequence[Surveyed]) -> dict[str, Mapping[str, Any]]:
    """Return, by photograph, what its recipe has beyond the default one, its files by their names; for a record."""
    notes = {s.capture.name: s.capture.recipe.identity() for s in surveyed}
    return {name: recipe for name, recipe in notes.items() if recipe}
