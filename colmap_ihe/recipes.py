"""How each photograph of the set is developed, from the options, the calibration frames and what EXIF says."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.captures.calibration import (
    BAD_PIXELS,
    KINDS,
    Kind,
    Master,
    Shot,
    flat_gain,
    groups_of,
    hot_pixels,
    matched,
    mean_of,
    read_bad_pixels,
    shot_of,
)
from colmap_ihe.captures.discover import RAW_SUFFIXES, Capture
from colmap_ihe.captures.metadata import read_metadata
from colmap_ihe.captures.mosaic import Mosaic
from colmap_ihe.captures.raw import bad_pixel_candidates, frames_of, read_header, read_mosaic
from colmap_ihe.captures.recipe import Recipe
from colmap_ihe.errors import PhotographError, ProjectError
from colmap_ihe.executor import in_order
from colmap_ihe.options import DevelopOptions
from colmap_ihe.per_image import LeftOut
from colmap_ihe.preprocess import Surveyed, survey
from colmap_ihe.progress import Audience, Watch
from colmap_ihe.project import digest_file, fingerprint_of, write_array
from colmap_ihe.version import library_versions

_LOOKED_AT = 16  # photographs, for bad pixels that all of them have
_FEWEST = 4  # of one camera; in fewer of them detail may stand still
_CONFIRMED = 0.9  # of the photographs looked at


@dataclass
class Recipes:
    """`surveyed`: the photographs with their recipes. `steps`: what is done to those of each kind of camera, in
    words, for the record; `warnings` what its owner should know."""

    surveyed: list[Surveyed]
    steps: dict[str, list[str]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def with_recipes(
    surveyed: Sequence[Surveyed],
    options: DevelopOptions,
    calibration: Path | None,
    store: Path,
    executor: Executor,
    watch: Watch,
    *,
    strict: bool,
) -> Recipes:
    """Gives every photograph its recipe. `calibration`: the user's folder of frames, if there is one; what is
    made of them is kept in `store`. Raises `ProjectError` for a folder that cannot be used, `PhotographError`
    for a broken frame if strict."""
    told: dict[str, list[str]] = defaultdict(list)
    masters: list[Master] = []
    listed = ""
    if calibration is not None and calibration.is_dir():
        masters = _masters(calibration, store, executor, watch, strict, lambda text: told[text].append(""))
        if (calibration / BAD_PIXELS).is_file():
            listed = _kept(store, "bad", read_bad_pixels(calibration / BAD_PIXELS))
    plain = Recipe(
        demosaic=options.demosaic, green_equilibrium=options.green_equilibrium, denoise=options.denoise
    )
    found = _found_over_the_set(surveyed, store, executor, watch, told) if options.find_bad_pixels else {}
    result = []
    for one in surveyed:
        recipe = plain if one.capture.kind == "raw" else Recipe(denoise=options.denoise)
        if one.sensor in ("bayer", "x-trans", "mosaic", "monochrome"):
            shot = shot_of(one.metadata, one.width, one.height)
            said: list[str] = []
            recipe, shown = matched(shot, masters, recipe, said.append)
            for text in said:
                told[text].append(one.capture.name)
            recipe = replace(recipe, bad_pixels=_united([*shown, listed, found.get(_camera(one), "")], store))
        result.append(replace(one, capture=replace(one.capture, recipe=recipe)))
    warnings = [f"{text}: {_some(names)}" if any(names) else text for text, names in told.items()]
    return Recipes(result, _steps(result), warnings)


def _masters(
    folder: Path,
    store: Path,
    executor: Executor,
    watch: Watch,
    strict: bool,
    say: Callable[[str], None],
) -> list[Master]:
    """The means of the frames below `folder`, flats last, since their own dark frames are taken from them."""
    masters: list[Master] = []
    for kind in KINDS:
        files = [
            p for p in sorted((folder / kind).rglob("*")) if p.suffix.lower() in RAW_SUFFIXES and p.is_file()
        ]
        watch.start(len(files), f"frames in {folder.name}/{kind}")
        shots = []
        for file in files:
            try:
                header = read_header(file)
                shots.append((str(file), shot_of(read_metadata(file, "raw"), header.width, header.height)))
            except PhotographError as error:
                if strict:
                    raise
                say(f"calibration frame left out: {error}")
        for shot, names in groups_of(shots, kind):
            try:
                masters.append(_master(kind, shot, names, masters, store, executor, watch))
            except PhotographError as error:
                if strict:
                    raise
                say(f"{len(names)} calibration frames left out: {error}")
    return masters


def _master(
    kind: Kind,
    shot: Shot,
    names: Sequence[str],
    before: Sequence[Master],
    store: Path,
    executor: Executor,
    watch: Watch,
) -> Master:
    dark_of_flat = Recipe()
    if kind == "flats":
        dark_of_flat, _ = matched(shot, [m for m in before if m.kind != "flats"], Recipe(), lambda _: None)
    content = [digest_file(Path(n)) for n in names]
    key = fingerprint_of(kind, sorted(content), dark_of_flat.as_dict(), library_versions("rawpy", "libraw"))
    file, bad = store / f"{kind}-{key}.npy", store / f"bad-{kind}-{key}.npy"
    if not file.exists() or not bad.exists():

        def read() -> Iterator[Mosaic]:
            for mosaic in in_order(executor, lambda n: read_mosaic(Path(n)), names):
                watch.advance()
                yield mosaic

        mean, like = mean_of(read())
        pixels: NDArray[np.intp] = np.empty((0, 2), np.intp)
        if kind == "flats":
            mean, pixels = flat_gain(mean, like, frames_of(dark_of_flat).dark)
        elif kind == "darks":
            pixels = hot_pixels(mean, like)
        write_array(bad, pixels)
        write_array(file, mean)
    else:
        watch.advance(len(names))
    return Master(kind, shot, len(names), str(file), str(bad))


def _found_over_the_set(
    surveyed: Sequence[Surveyed],
    store: Path,
    executor: Executor,
    watch: Watch,
    told: dict[str, list[str]],
) -> dict[tuple[str, ...], str]:
    """By camera, the file of the pixels that stand out in nearly all of its photographs."""
    cameras: dict[tuple[str, ...], list[Path]] = defaultdict(list)
    for one in surveyed:
        if one.sensor == "bayer":
            cameras[_camera(one)].append(one.capture.path)
        elif one.sensor in ("x-trans", "mosaic", "monochrome"):
            text = f"bad pixels are looked for on Bayer sensors only; list them in {BAD_PIXELS}"
            told[text].append(one.capture.name)
    found = {}
    for camera, paths in cameras.items():
        if len(paths) < _FEWEST:
            told[f"{len(paths)} photographs of one camera are too few to find its bad pixels in"].append("")
            continue
        some = paths[:: -(-len(paths) // _LOOKED_AT)]
        watch.start(len(some), "images, for bad pixels")
        candidates = []
        for pixels in in_order(executor, bad_pixel_candidates, some):
            candidates.append(pixels)
            watch.advance()
        places, counts = np.unique(np.concatenate(candidates), axis=0, return_counts=True)
        found[camera] = _kept(store, "bad", places[counts >= _CONFIRMED * len(some)])
    return found


def _camera(one: Surveyed) -> tuple[str, ...]:
    said = one.metadata
    return (said.make, said.model, said.serial, str(one.width), str(one.height))


def _kept(store: Path, name: str, array: NDArray[Any]) -> str:
    file = store / f"{name}-{fingerprint_of(array.shape, array.tolist())}.npy"
    if not file.exists():
        write_array(file, array)
    return str(file)


def _united(files: Sequence[str], store: Path) -> str:
    """The file of all pixels in `files`, empty if there are none."""
    lists = [np.load(f, allow_pickle=False) for f in sorted({f for f in files if f})]
    lists = [pixels for pixels in lists if len(pixels)]
    return _kept(store, "bad", np.unique(np.concatenate(lists), axis=0)) if lists else ""


def _steps(surveyed: Sequence[Surveyed]) -> dict[str, list[str]]:
    """What is done to the photographs of each kind of sensor and recipe, with what does not apply left out."""
    kinds: dict[str, list[str]] = {}
    for one in surveyed:
        if one.capture.kind != "raw":
            continue
        said, recipe = one.metadata, one.capture.recipe
        steps = list(_steps_of(recipe, one.sensor))
        label = f"{said.make} {said.model}".strip() or "unknown camera"
        name = f"{label}, {one.sensor}"
        number = 1
        while kinds.setdefault(name, steps) != steps:
            number += 1
            name = f"{label}, {one.sensor} ({number})"
    return kinds


def _steps_of(recipe: Recipe, sensor: str) -> Iterator[str]:
    if sensor == "demosaiced":
        yield "black level"
        return
    if recipe.bias and recipe.dark:
        yield f"bias and dark frame, scaled by {recipe.dark_scale:g}"
    elif recipe.bias or recipe.dark:
        yield "dark frame" if recipe.dark else "bias frame"
    else:
        yield "black level"
    if recipe.flat:
        yield "flat field"
    if recipe.bad_pixels:
        yield f"{len(np.load(recipe.bad_pixels, allow_pickle=False))} bad pixels"
    if sensor == "bayer" and recipe.green_equilibrium:
        yield "green equilibrium"
    if sensor != "monochrome":
        yield f"demosaicing ({recipe.demosaic})"


def _some(names: Sequence[str]) -> str:
    shown = [n for n in names if n][:5]
    return ", ".join(shown) + (f" and {len(names) - len(shown)} more" if len(names) > len(shown) else "")


@contextmanager
def prepared_set(
    captures: Sequence[Capture],
    options: DevelopOptions | None,
    calibration: Path | None,
    executor: Executor,
    audience: Audience,
    *,
    strict: bool,
) -> Iterator[tuple[list[Surveyed], LeftOut]]:
    """Photographs surveyed and with their recipes, for work outside of a project: the means of calibration
    frames last as long as the context. Raises as `with_recipes`, and `ProjectError` for a `calibration` that is
    no folder."""
    if calibration is not None and not calibration.is_dir():
        raise ProjectError(
            f"{calibration}: no such folder of calibration frames",
            hint="name a folder with bias/, darks/, flats/ or bad-pixels.txt in it",
        )
    with TemporaryDirectory(prefix="colmap-ihe-") as store:
        with audience.stage("captures") as watch:
            surveyed, left_out = survey(captures, executor, watch, strict=strict)
            options = options or DevelopOptions()
            found = with_recipes(surveyed, options, calibration, Path(store), executor, watch, strict=strict)
        for text in found.warnings:
            audience.warn(text)
        yield found.surveyed, left_out


def recipe_notes(surveyed: Sequence[Surveyed]) -> dict[str, Mapping[str, Any]]:
    """By photograph, what its recipe has beyond the default one; for a record."""
    notes = chain((s.capture.name, s.capture.recipe.as_dict()) for s in surveyed)
    return {name: recipe for name, recipe in notes if recipe}
