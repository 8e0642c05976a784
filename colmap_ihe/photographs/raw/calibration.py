"""Calibration frames: which of them belong to a shot, and what is averaged of them.

A folder of them holds `bias/`, `darks/` and `flats/` with RAW files of the same camera, and `bad-pixels.txt`; the
folders may be called `Dark`, `flat-field` or `offsets` as well.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.files import read_at_most
from colmap_ihe.photographs.exif.metadata import Metadata
from colmap_ihe.photographs.raw.mosaic import Mosaic, tiled
from colmap_ihe.project.recipe import Recipe

Kind = Literal["bias", "darks", "flats"]
KINDS: tuple[Kind, ...] = ("bias", "darks", "flats")
_BEGINNINGS: dict[str, Kind] = {"bias": "bias", "offset": "bias", "dark": "darks", "flat": "flats"}
BAD_PIXELS = "bad-pixels.txt"
_MOST_LISTED = 50_000_000  # bytes of a list of bad pixels

_SAME = 1.1  # exposures and sensitivities that differ by less are the same
_HOT_SIGMAS, _LEAST_HOT = 10.0, 0.005  # above the pixels around; of the span from black to white
_DEAD, _GLARING = 0.5, 1.5  # of the light that the pixels around see
_LEAST_FLAT = 0.02  # of the mean: where less light came through, a flat field is noise


def kind_of_folder(name: str) -> Kind | None:
    """Return the kind of frames that a folder of this name holds, None for a folder of another kind."""
    return next((k for beginning, k in _BEGINNINGS.items() if name.casefold().startswith(beginning)), None)


@dataclass(frozen=True)
class Shot:
    """Describe a shot, to tell which frames belong to it. Sizes in pixels of the mosaic; `exposure_s`, `iso`,
    `f_number` and `focal_mm` are 0 and the names empty where EXIF does not say them."""

    width: int
    height: int
    make: str = ""
    model: str = ""
    serial: str = ""
    exposure_s: float = 0.0
    iso: float = 0.0
    lens: str = ""
    focal_mm: float = 0.0
    f_number: float = 0.0

    def same_camera(self, other: Shot) -> bool:
        names = (self.make, self.model, self.serial), (other.make, other.model, other.serial)
        same = all(a == b for a, b in zip(*names, strict=True) if a and b)
        return same and (self.width, self.height) == (other.width, other.height)


def shot_of(metadata: Metadata, width: int, height: int) -> Shot:
    names = ("make", "model", "serial", "exposure_s", "iso", "lens", "focal_mm", "f_number")
    return Shot(width, height, **{name: getattr(metadata, name) for name in names})


@dataclass(frozen=True)
class Master:
    """Describe the mean of some frames of one kind, in `file`; `bad`: the file of the bad pixels that they show."""

    kind: Kind
    shot: Shot
    frames: int
    file: str
    bad: str = ""


def groups_of(shots: Iterable[tuple[str, Shot]], kind: Kind) -> list[tuple[Shot, list[str]]]:
    """Return the frames that are averaged together, by name: those of one camera, sensitivity and exposure; flat
    fields besides of one lens, focal length and aperture."""
    groups: dict[Shot, list[str]] = defaultdict(list)
    for name, shot in shots:
        key = shot if kind == "flats" else replace(shot, lens="", focal_mm=0.0, f_number=0.0)
        if kind == "bias":
            key = replace(key, exposure_s=0.0)
        groups[key].append(name)
    return list(groups.items())


def mean_of(mosaics: Iterable[Mosaic]) -> tuple[NDArray[np.float32], Mosaic]:
    """Return the mean of frames of one size, (H, W) float32 in the sensor's units, and the last of them. Raises
    `ProjectError` for none, or for frames of several sizes."""
    total: NDArray[np.float64] | None = None
    last, count = None, 0
    for last in mosaics:
        if total is None:
            total = np.zeros(last.values.shape, np.float64)
        if total.shape != last.values.shape:
            raise ProjectError("calibration frames of several sizes", hint="keep those of one size")
        total += last.values
        count += 1
    if total is None or last is None:
        raise ProjectError("no calibration frame can be read", hint="take them out of the folder")
    return np.asarray(total / count, np.float32), last


def flat_gain(
    mean: NDArray[np.float32], like: Mosaic, dark: NDArray[np.float32] | None
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return the factors that even the response out, (H, W) float32, and the bad pixels (N, 2). Normalised to a mean
    of 1 in each channel by itself, so that it changes no balance between them. `dark` as in `Frames`, of the flat's
    own."""
    light = mean - (tiled(like.black, mean.shape) if dark is None else dark)
    gain: NDArray[np.float32] = np.ones_like(light)
    bad = []
    colours = np.where(like.pattern == 3, 1, like.pattern)  # both greens are one channel
    for colour in np.unique(colours):
        places = np.argwhere(colours == colour)
        level = np.mean([light[y :: _n(like), x :: _n(like)].mean() for y, x in places])
        for y, x in places:
            cells = light[y :: _n(like), x :: _n(like)]
            gain[y :: _n(like), x :: _n(like)] = level / np.maximum(cells, _LEAST_FLAT * level)
    for (y, x), cells, around in _phases(light, like):
        odd = (cells < _DEAD * around) | (cells > _GLARING * around)
        bad.append(np.argwhere(odd) * _n(like) + (y, x))
    pixels = np.concatenate(bad)
    gain[pixels[:, 0], pixels[:, 1]] = 1
    return gain, pixels


def hot_pixels(dark: NDArray[np.float32], like: Mosaic) -> NDArray[np.intp]:
    """Return pixels, (N, 2), of a dark frame far above those of their colour around them."""
    bad = []
    for (y, x), cells, around in _phases(dark, like):
        excess = cells - around
        noise = 1.4826 * float(np.median(np.abs(excess)))
        hot = excess > max(_HOT_SIGMAS * noise, _LEAST_HOT * like.span)
        bad.append(np.argwhere(hot) * _n(like) + (y, x))
    return np.concatenate(bad)


def _n(like: Mosaic) -> int:
    return int(like.pattern.shape[0])


def _phases(
    plane: NDArray[np.float32], like: Mosaic
) -> Iterable[tuple[tuple[int, int], NDArray[np.float32], NDArray[np.float32]]]:
    """Yield each place of the pattern, its pixels, and the median of those around each of them."""
    for y, x in np.ndindex(*like.pattern.shape):
        cells = np.ascontiguousarray(plane[y :: _n(like), x :: _n(like)])
        yield (y, x), cells, np.asarray(cv2.medianBlur(cells, 5), np.float32)


def read_bad_pixels(file: Path) -> NDArray[np.intp]:
    """Return (N, 2), row and column, of a list in dcraw's format: column and row of the picture on each line, what
    follows is passed over, as is what follows a #. Raises `ProjectError`."""
    pixels = []
    try:
        lines = read_at_most(file, _MOST_LISTED).decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ProjectError(f"{file}: cannot be read ({error})", hint="save it as plain text") from error
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) < 2 or not all(w.isdecimal() and len(w) < 7 for w in words[:2]):
            raise ProjectError(
                f"{file}, line {number}: {line.strip()!r:.60}, expected a column and a row, as 1204 377",
                hint="correct or remove the line",
            )
        pixels.append((int(words[1]), int(words[0])))
    return np.array(pixels, np.intp).reshape(-1, 2)


def matched(
    shot: Shot, masters: Sequence[Master], plain: Recipe, say: Callable[[str], None]
) -> tuple[Recipe, tuple[str, ...]]:
    """Return the recipe of a shot with the frames that belong to it, and the files of the bad pixels that they show.

    A dark frame has to be of the shot's sensitivity and exposure; with bias frames of that sensitivity one of
    another exposure is scaled to it. Where EXIF does not say, frames of the same camera are taken to belong. A
    flat field should be of the shot's lens, focal length and aperture, and the one that shares most of them is
    taken. What does not fit is told to `say`.
    """
    mine = [m for m in masters if m.shot.same_camera(shot)]
    bias = _of_iso(shot, [m for m in mine if m.kind == "bias"])
    darks = _all_of_iso(shot, [m for m in mine if m.kind == "darks"])
    flats = [m for m in mine if m.kind == "flats"]
    recipe, used = plain, [m for m in (bias,) if m]
    dark = min(darks, key=lambda m: _apart(m.shot.exposure_s, shot.exposure_s), default=None)
    scaled = dark is not None and _apart(dark.shot.exposure_s, shot.exposure_s) > _SAME
    if dark is not None and not scaled:
        recipe, used = replace(recipe, dark=dark.file), [dark]
    elif dark is not None and bias is not None:
        factor = shot.exposure_s / dark.shot.exposure_s
        recipe = replace(recipe, bias=bias.file, dark=dark.file, dark_scale=round(factor, 4))
        used.append(dark)
    elif bias is not None:
        recipe = replace(recipe, bias=bias.file)
    if dark is not None and scaled and bias is None:
        say(f"no dark frame of {shot.exposure_s:g} s, and no bias frame to scale one with")
    elif not darks and any(m.kind == "darks" for m in mine):
        say(f"no dark frame of ISO {shot.iso:g}")
    flat = max(flats, key=lambda m: (_shared(m.shot, shot), m.frames), default=None)
    if flat is not None:
        recipe = replace(recipe, flat=flat.file)
        used.append(flat)
        if _shared(flat.shot, shot) < 3:
            say(f"the flat field is not of its lens, focal length and aperture ({_way(shot)}) in all")
    if masters and not mine:
        say("no calibration frame is of its camera and size")
    # What hot pixels there are hangs little on the exposure: those that any dark frame of the camera shows.
    bad = {m.bad for m in mine if m.bad and (m.kind != "flats" or m is flat)}
    return recipe, tuple(sorted(bad))


def _apart(amount: float, other: float) -> float:
    """Return the factor between two amounts, 1 where one is not known."""
    return max(amount, other) / min(amount, other) if amount > 0 and other > 0 else 1.0


def _all_of_iso(shot: Shot, masters: Sequence[Master]) -> list[Master]:
    return [m for m in masters if _apart(m.shot.iso, shot.iso) <= _SAME]


def _of_iso(shot: Shot, masters: Sequence[Master]) -> Master | None:
    return min(_all_of_iso(shot, masters), key=lambda m: _apart(m.shot.iso, shot.iso), default=None)


def _shared(shot: Shot, other: Shot) -> int:
    same = _apart(shot.focal_mm, other.focal_mm) <= _SAME, _apart(shot.f_number, other.f_number) <= _SAME
    return sum(same) + (shot.lens == other.lens)


def _way(shot: Shot) -> str:
    focal = f"{shot.focal_mm:g} mm" if shot.focal_mm else ""
    aperture = f"f/{shot.f_number:g}" if shot.f_number else ""
    return ", ".join(part for part in (shot.lens, focal, aperture) if part) or "not known"
