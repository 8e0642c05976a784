"""Means of calibration frames, and bad pixels that they or the photographs themselves show, kept in files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_pool import in_decoder
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.files import digest_file, fingerprint_of, leads_out, write_array
from colmap_ihe.machine.libraries import library_versions
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.decode import refuse_too_large
from colmap_ihe.photographs.discover import RAW_SUFFIXES, is_foreign
from colmap_ihe.photographs.exif.metadata import read_metadata
from colmap_ihe.photographs.raw import calibration
from colmap_ihe.photographs.raw.develop import bad_pixel_candidates, frames_of, read_header, read_mosaic
from colmap_ihe.photographs.raw.mosaic import Mosaic
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.project.recipe import Recipe

_LOOKED_AT = 16  # photographs, for bad pixels that all of them have
_FEWEST = 4  # of one camera; in fewer of them detail may stand still
_CONFIRMED = 0.9  # of the photographs looked at
_Result = TypeVar("_Result")


def masters_of(
    folder: Path,
    store: Path,
    executor: Executor,
    progress: Progress,
    strict: bool,
    say: Callable[[str], None],
) -> list[calibration.Master]:
    """Return the means of the frames below `folder`, flats last, since their own dark frames are taken from them."""

    def leave_out(error: PhotographError) -> None:
        if strict:
            raise error
        say(f"calibration frame left out: {error}")

    if unused := list(_unused_in(folder)):
        say(
            f"not used: {', '.join(unused)}; calibration frames are RAW files in {folder.name}/bias, darks and flats,"
            f" and bad pixels are listed in {folder.name}/{calibration.BAD_PIXELS}"
        )
    masters: list[calibration.Master] = []
    for kind in calibration.KINDS:
        files = _frames_of(folder, kind)
        progress.start(len(files), f"frames in {folder.name}/{kind}")
        shots = []
        for file, below in files:
            try:
                shots.append((str(file), _shot(file, below)))
            except PhotographError as error:
                leave_out(error)
        for shot, names in calibration.groups_of(shots, kind):
            dark = Recipe()
            if kind == "flats":
                known = [m for m in masters if m.kind != "flats"]
                dark, _ = calibration.matched(shot, known, dark, lambda _: None)
            left = names
            while left:
                broken: dict[str, PhotographError] = {}
                try:
                    masters.append(_master(kind, shot, left, dark, store, executor, progress, broken))
                    break
                except PhotographError:  # the others begin again: what is kept is named after them
                    for reason in broken.values():
                        leave_out(reason)
                    left = [name for name in left if name not in broken]
    return masters


def _unused_in(folder: Path) -> Iterator[str]:
    """Yield what lies in the folder and is neither a folder with frames nor the list of bad pixels."""
    for entry in sorted(e for e in folder.iterdir() if not is_foreign(e.relative_to(folder))):
        if entry.is_file():
            if entry.name != calibration.BAD_PIXELS:
                yield f"{folder.name}/{entry.name}"
        elif calibration.kind_of_folder(entry.name) is None:
            yield f"{folder.name}/{entry.name}/"
        elif not any(file.suffix.lower() in RAW_SUFFIXES for file in entry.rglob("*")):
            yield f"{folder.name}/{entry.name}/ (no RAW file in it)"


def _frames_of(folder: Path, kind: calibration.Kind) -> list[tuple[Path, Path]]:
    """Return the RAW files in the folders of this kind, sorted, each with the folder that it lies in."""
    folders = [f for f in folder.iterdir() if f.is_dir() and calibration.kind_of_folder(f.name) == kind]
    files = ((file, f) for f in folders for file in f.rglob("*") if file.suffix.lower() in RAW_SUFFIXES)
    return sorted(
        (file, f) for file, f in files if file.is_file() and not is_foreign(file.relative_to(folder))
    )


def _shot(file: Path, folder: Path) -> calibration.Shot:
    if leads_out(file, folder):
        raise PhotographError(
            f"{file.name}: a link that leads out of the folder of frames", hint="put the frame in its place"
        )
    header = in_decoder(read_header, file)
    refuse_too_large(file.name, header.width, header.height)
    return calibration.shot_of(read_metadata(file, "raw"), header.width, header.height)


def _master(
    kind: calibration.Kind,
    shot: calibration.Shot,
    names: Sequence[str],
    dark_of_flat: Recipe,
    store: Path,
    executor: Executor,
    progress: Progress,
    broken: dict[str, PhotographError],
) -> calibration.Master:
    """Average the frames called `names`. Raises `PhotographError` for pixels that cannot be read; the frames are then
    in `broken`."""
    content = [digest_file(Path(n)) for n in names]
    key = fingerprint_of(kind, sorted(content), dark_of_flat.as_dict(), library_versions("rawpy", "libraw"))
    file, bad = store / f"{kind}-{key}.npy", store / f"bad-{kind}-{key}.npy"
    if not file.exists() or not bad.exists():

        def read(name: str) -> Mosaic:
            try:
                return in_decoder(read_mosaic, Path(name), pixels=0)
            except PhotographError as error:
                broken[name] = error
                raise

        mean, like = calibration.mean_of(_watched(in_order(executor, read, names), progress))
        pixels: NDArray[np.intp] = np.empty((0, 2), np.intp)
        if kind == "flats":
            mean, pixels = calibration.flat_gain(mean, like, frames_of(dark_of_flat).dark)
        elif kind == "darks":
            pixels = calibration.hot_pixels(mean, like)
        write_array(bad, pixels)
        write_array(file, mean)
    else:
        progress.advance(len(names))
    return calibration.Master(kind, shot, len(names), str(file), str(bad))


def _watched(results: Iterable[_Result], progress: Progress) -> Iterator[_Result]:
    for result in results:
        progress.advance()
        yield result


def bad_pixels_of_set(
    surveyed: Sequence[Surveyed],
    store: Path,
    executor: Executor,
    progress: Progress,
    warnings: dict[str, list[str]],
) -> dict[tuple[str, ...], str]:
    """Return, by camera, the file of the pixels that stand out in nearly all of its photographs."""
    cameras: dict[tuple[str, ...], list[Path]] = defaultdict(list)
    for photograph in surveyed:
        if photograph.sensor == "bayer":
            cameras[camera_of(photograph)].append(photograph.capture.path)
        elif photograph.sensor in ("x-trans", "mosaic", "monochrome"):
            text = f"bad pixels are looked for on Bayer sensors only; list them in {calibration.BAD_PIXELS}"
            warnings[text].append(photograph.capture.name)
    files = {}
    for camera, paths in cameras.items():
        if len(paths) < _FEWEST:
            text = f"{len(paths)} photographs of one camera are too few to find its bad pixels in"
            warnings[text].append("")
            continue
        sample = paths[:: -(-len(paths) // _LOOKED_AT)]
        progress.start(len(sample), "images, for bad pixels")
        look = partial(in_decoder, bad_pixel_candidates, pixels=0)
        candidates = _watched(in_order(executor, look, sample, progress=progress), progress)
        places, counts = np.unique(np.concatenate(list(candidates)), axis=0, return_counts=True)
        files[camera] = save_bad_pixels(store, places[counts >= _CONFIRMED * len(sample)])
    return files


def camera_of(photograph: Surveyed) -> tuple[str, ...]:
    metadata = photograph.metadata
    return (metadata.make, metadata.model, metadata.serial, str(photograph.width), str(photograph.height))


def save_bad_pixels(store: Path, pixels: NDArray[np.intp]) -> str:
    """Return the file of these bad pixels, named after them."""
    file = store / f"bad-{fingerprint_of(pixels.tolist())}.npy"
    if not file.exists():
        write_array(file, pixels)
    return str(file)


def union_of(files: Sequence[str], store: Path) -> str:
    """Return the file of all pixels in `files`, empty if there are none."""
    lists = [np.load(f, allow_pickle=False) for f in sorted({f for f in files if f})]
    lists = [pixels for pixels in lists if len(pixels)]
    return save_bad_pixels(store, np.unique(np.concatenate(lists), axis=0)) if lists else ""
