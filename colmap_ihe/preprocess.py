"""From photographs to grey images: what captures say, one fit over the set, one conversion each.

The fit is the one place where the whole set meets; before and after it everything is one image at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.captures.decode import Photograph, encoding_of, read_photograph, read_size
from colmap_ihe.captures.discover import Capture
from colmap_ihe.captures.encode import SUFFIXES, encode_image
from colmap_ihe.captures.metadata import Metadata, read_metadata
from colmap_ihe.captures.png import encode_png
from colmap_ihe.errors import PhotographError, ProjectError, WeightsError
from colmap_ihe.executor import in_order
from colmap_ihe.grey.boxes import Triplet
from colmap_ihe.grey.convert import to_colour, to_grey
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.ihe import count_levels, fit_histogram, white_point
from colmap_ihe.grey.weights import FIXED, Encoding, Weights, triplets
from colmap_ihe.options import ConvertOptions, FitOptions
from colmap_ihe.progress import Watch
from colmap_ihe.project import write_bytes

LeftOut = dict[str, str]
"""Captures that cannot be used, by name, each with the reason and what to do."""

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Surveyed:
    """A capture with what its header says; sizes in pixels."""

    capture: Capture
    width: int
    height: int
    metadata: Metadata


@dataclass(frozen=True)
class Fit:
    """The weights of the set, one for each encoding in it; `colour_white` is the white point of a linear
    set's colour twins, as a share of saturation."""

    weights: Mapping[Encoding, Weights]
    colour_white: float = 1.0
    left_out: LeftOut = field(default_factory=dict)

    @property
    def main(self) -> Weights:
        """Of the encoding with most images."""
        return max(self.weights.values(), key=lambda w: w.images)


def survey(
    captures: Sequence[Capture], executor: Executor, watch: Watch, *, strict: bool
) -> tuple[list[Surveyed], LeftOut]:
    """Sizes and EXIF of all captures. Raises `PhotographError` if strict, `ProjectError` if none is usable."""

    def look(capture: Capture) -> Surveyed:
        width, height = read_size(capture)
        return Surveyed(capture, width, height, read_metadata(capture.path, capture.kind))

    left_out: LeftOut = {}
    return list(_each(look, captures, executor, watch, strict, left_out)), left_out


def fit_captures(
    captures: Sequence[Capture], options: FitOptions, executor: Executor, watch: Watch, *, strict: bool
) -> Fit:
    """One triplet over the whole set, from every pixel of every capture, one image in memory a worker.

    A set that mixes gamma-coded and linear photographs gets a triplet for each: a sensor's red is not
    sRGB's red, so one triplet for both would mean two different greys. Raises as `survey`.
    """
    left_out: LeftOut = {}
    histograms: dict[Encoding, Histogram] = {}
    members: dict[Encoding, list[Capture]] = {"coded": [], "linear": []}

    def decode(capture: Capture) -> tuple[Capture, Encoding, NDArray[np.uint8] | NDArray[np.uint16]]:
        photograph = read_photograph(capture)
        return capture, photograph.encoding, _sampled(photograph, options.sample)

    for capture, encoding, rgb in _each(decode, captures, executor, watch, strict, left_out):
        histogram = histograms.setdefault(encoding, Histogram(encoding))
        histogram.add(rgb, weighting=options.weighting)
        members[encoding].append(capture)

    def weights_of(encoding: Encoding, histogram: Histogram) -> Weights:
        if options.method != "ihe":
            triplet = FIXED[options.method]
            white = white_point(histogram, triplet) if encoding == "linear" else 1.0
            return Weights(
                *triplet,
                method=options.method,
                encoding=encoding,
                white=white,
                images=histogram.images,
                pixels=histogram.pixels,
            )

        def recount(chosen: Sequence[Triplet], whites: Sequence[int]) -> NDArray[np.int64]:
            def count(capture: Capture) -> NDArray[np.int64]:
                rgb = _sampled(read_photograph(capture), options.sample)
                mass = histogram.mass_of(rgb, options.weighting)
                return count_levels(rgb, chosen, whites) * mass

            watch.start(len(members[encoding]), f"images, for {len(chosen)} triplets")
            total: NDArray[np.int64] = np.zeros((len(chosen), 256), np.int64)
            for counts in in_order(executor, count, members[encoding]):
                total += counts
                watch.advance()
            return total

        watch.start(len(triplets(options.step)), "triplets")
        recount_if_linear = recount if encoding == "linear" else None
        return fit_histogram(histogram, options.step, recount_if_linear, watch.advance, exact=options.exact)

    weights = {encoding: weights_of(encoding, histogram) for encoding, histogram in histograms.items()}
    linear = histograms.get("linear")
    return Fit(weights, white_point(linear, FIXED["green"]) if linear else 1.0, left_out)


def convert_captures(
    surveyed: Sequence[Surveyed],
    fit: Fit,
    options: ConvertOptions,
    grey_folder: Path,
    colour_folder: Path | None,
    executor: Executor,
    watch: Watch,
    *,
    strict: bool,
    keep_finished: bool,
) -> tuple[dict[str, str], LeftOut]:
    """Writes the grey image of every capture, with its EXIF, and its colour twin where a folder is given.

    Returns the names of the grey images by capture, and what was left out. `keep_finished` leaves alone
    what is there under its final name: the caller knows that it comes from the same input. Raises as
    `survey`, `WeightsError` if the weights are for another encoding, `DiskFullError`.
    """
    left_out: LeftOut = {}

    def convert(one: Surveyed) -> tuple[str, str]:
        name = one.capture.grey_stem + SUFFIXES[options.format]
        grey_file, colour_file = grey_folder / name, colour_folder / name if colour_folder else None
        grey_due = not (keep_finished and grey_file.exists())
        colour_due = colour_file is not None and not (keep_finished and colour_file.exists())
        if not grey_due and not colour_due:
            return one.capture.name, name
        photograph = read_photograph(one.capture)
        exif, weights = one.metadata.exif, weights_for(one.capture, fit)
        if grey_due:
            grey = to_grey(photograph.rgb, weights, options.tone)
            write_bytes(grey_file, encode_image(grey, exif, options.format))
        if colour_file is not None and colour_due:
            colour = _colour_twin(photograph, fit.colour_white)
            write_bytes(colour_file, encode_image(colour, exif, options.format, photograph.profile))
        return one.capture.name, name

    names = [s.capture for s in surveyed]
    by_name = {s.capture.name: s for s in surveyed}
    pairs = _each(lambda c: convert(by_name[c.name]), names, executor, watch, strict, left_out)
    return dict(pairs), left_out


def write_masks(masks: Path, grey_names: Mapping[str, str], grey_folder: Path, out: Path) -> set[str]:
    """COLMAP's masks for grey images (GREY.png.png, black is left out) from those of the user, who may name a
    mask after the photograph (IMG.JPG.png) or the grey image; white where there is none.

    `grey_names` by photograph. Returns the masks used. Raises `ProjectError` for one of another size.
    """
    used = set()
    for photograph, grey in grey_names.items():
        with Image.open(grey_folder / grey) as image:
            size = image.size
        mask = np.full(size[::-1], 255, np.uint8)
        for name in (f"{photograph}.png", f"{grey}.png"):
            if not (masks / name).is_file():
                continue
            mask = _read_mask(masks / name)
            if mask.shape != size[::-1]:
                raise ProjectError(
                    f"{masks / name}: {mask.shape[1]}x{mask.shape[0]} pixels, its photograph has {size[0]}x{size[1]}",
                    hint="masks have the size of the photograph as stored, not turned upright",
                )
            used.add(name)
            break
        write_bytes(out / f"{grey}.png", encode_png(mask))
    return used


def _read_mask(path: Path) -> NDArray[np.uint8]:
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("L"))
    except (OSError, SyntaxError, ValueError) as error:
        raise ProjectError(
            f"{path}: cannot be read as a mask ({error})", hint="save it as a PNG again"
        ) from error


def weights_for(capture: Capture, fit: Fit) -> Weights:
    """The weights that this photograph is converted with. Raises `WeightsError` if there are none."""
    encoding = encoding_of(capture)
    weights = fit.weights.get(encoding)
    if weights is None:
        raise WeightsError(
            f"{capture.name}: a {encoding} photograph, and the weights are for "
            f"{' and '.join(fit.weights)} ones",
            hint="fit weights on photographs of this kind; RAW is linear, JPEG is gamma-coded",
        )
    return weights


def _colour_twin(photograph: Photograph, white: float) -> NDArray[np.uint8]:
    if photograph.srgb_from_camera is None:
        return np.asarray(photograph.rgb, np.uint8)
    return to_colour(np.asarray(photograph.rgb, np.uint16), photograph.srgb_from_camera, white)


def _sampled(photograph: Photograph, sample: float) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The photograph at `sample` of each side, nearest neighbour, at least one pixel."""
    if sample == 1:
        return photograph.rgb
    height, width = photograph.rgb.shape[:2]
    size = (max(1, round(width * sample)), max(1, round(height * sample)))
    resized: Any = cv2.resize(photograph.rgb, size, interpolation=cv2.INTER_NEAREST)
    return resized  # type: ignore[no-any-return]


def _each(
    function: Callable[[Capture], _Result],
    captures: Sequence[Capture],
    executor: Executor,
    watch: Watch,
    strict: bool,
    left_out: LeftOut,
) -> Iterable[_Result]:
    """`function` of every capture that can be used; the others go to `left_out`, or end the run if strict."""

    def guarded(capture: Capture) -> _Result | PhotographError:
        try:
            return function(capture)
        except PhotographError as error:
            return error

    watch.start(len(captures))
    usable = 0
    for capture, result in zip(captures, in_order(executor, guarded, captures), strict=True):
        watch.advance()
        if isinstance(result, PhotographError):
            if strict:
                raise result
            left_out[capture.name] = f"{result}; {result.hint}" if result.hint else str(result)
            continue
        usable += 1
        yield result
    if not usable:
        reasons = "; ".join(str(r) for r in list(left_out.values())[:3])
        raise ProjectError(
            f"none of the {len(captures)} photographs can be used: {reasons}",
            hint="copy them from the card again",
        )
