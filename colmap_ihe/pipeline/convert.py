"""Before and after the fit, one image at a time: what captures say, and from each its grey image."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.errors import ProjectError, WeightsError
from colmap_ihe.fit.fit_set import Fit
from colmap_ihe.grey.convert import check_tone, to_colour, to_grey
from colmap_ihe.grey.wallis import wallis
from colmap_ihe.grey.weights import Grey
from colmap_ihe.machine.executor import shares_memory
from colmap_ihe.machine.files import leads_out, open_file, write_bytes
from colmap_ihe.machine.memory import at_once, keep_freed
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.decode import DecodedPhotograph, encoding_of, read_photograph
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut, each_usable
from colmap_ihe.photographs.encode import SUFFIXES, encode_image
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.project.options import ConvertOptions

_WAITING = 3
"""Files that wait for the disk, for each photograph that is worked on: a disk that takes its time now and then holds
nobody up."""
MASKS = ("PNG", "JPEG", "TIFF", "BMP")
"""The kinds of files that are read as masks, whatever their name: Pillow would run a program for some others."""
_UNREADABLE_MASK = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    struct.error,
    Image.DecompressionBombError,
    MemoryError,
)


def convert_captures(
    surveyed: Sequence[Surveyed],
    fit: Fit,
    options: ConvertOptions,
    grey_folder: Path,
    colour_folder: Path | None,
    executor: Executor,
    progress: Progress,
    *,
    strict: bool,
    keep_finished: bool,
) -> tuple[dict[str, str], LeftOut]:
    """Writes the grey image of every capture, with its EXIF, and its colour twin where a folder is given.

    Returns the names of the grey images by capture, and what was left out. `keep_finished` leaves alone
    what is there under its final name: the caller knows that it comes from the same input. Raises as
    `survey`, `WeightsError` if the weights are for another encoding or cannot have the tone, `DiskFullError`.
    """
    for weights in fit.weights.values():
        check_tone(weights, options.tone)
    left_out: LeftOut = {}
    convert = partial(_converted, fit, options, grey_folder, colour_folder, keep_finished)
    names = {s.capture.name: s.capture.grey_stem + SUFFIXES[options.format] for s in surveyed}
    if not shares_memory(executor):
        converted = partial(_write_converted, convert)
        done = list(each_usable(converted, surveyed, executor, progress, strict, left_out))
        return {name: names[name] for name in done}, left_out

    def converted_here(one: Surveyed) -> tuple[str, list[Future[None]]]:
        return one.capture.name, [disk.submit(write_bytes, file, content) for file, content in convert(one)]

    waiting: deque[Future[None]] = deque()
    most = _WAITING * at_once([one.capture for one in surveyed], local_workers())
    finished = []
    # Threads of their own: to wait until the disk has a file takes no core.
    with ThreadPoolExecutor(local_workers(), thread_name_prefix="write") as disk:
        for name, writes in each_usable(converted_here, surveyed, executor, progress, strict, left_out):
            finished.append(name)
            waiting += writes
            while len(waiting) > most:
                waiting.popleft().result()
        for write in waiting:
            write.result()
    return {name: names[name] for name in finished}, left_out


_Convert = Callable[[Surveyed], Iterator[tuple[Path, bytes]]]


def _write_converted(convert: _Convert, one: Surveyed) -> str:
    for file, content in convert(one):
        write_bytes(file, content)
    return one.capture.name


def _converted(
    fit: Fit,
    options: ConvertOptions,
    grey_folder: Path,
    colour_folder: Path | None,
    keep_finished: bool,
    one: Surveyed,
) -> Iterator[tuple[Path, bytes]]:
    """The files of one photograph that are due, with what is to be in them."""
    name = one.capture.grey_stem + SUFFIXES[options.format]
    grey_file, colour_file = grey_folder / name, colour_folder / name if colour_folder else None
    grey_due = not (keep_finished and grey_file.exists())
    colour_due = colour_file is not None and not (keep_finished and colour_file.exists())
    if not grey_due and not colour_due:
        return
    keep_freed()
    photograph = read_photograph(one.capture)
    exif, weights = one.metadata.exif, weights_for(one.capture, fit)
    if grey_due:
        grey = to_grey(photograph.rgb, weights, options.tone)
        if options.wallis:
            grey = wallis(grey)
        yield grey_file, encode_image(grey, exif, options.format)
    if colour_file is not None and colour_due:
        colour = _colour_twin(photograph, fit.colour_white)
        yield colour_file, encode_image(colour, exif, options.format, photograph.profile)


def write_masks(masks: Path, grey_names: Mapping[str, str], grey_folder: Path, out: Path) -> set[str]:
    """COLMAP's masks for grey images (GREY.png.png, black is left out) from those of the user, who may name a
    mask after the photograph (IMG.JPG.png) or the grey image; white where there is none.

    `grey_names` by photograph. Returns the masks used. Raises `ProjectError` for one that
    cannot be read, is of another size, or lies elsewhere.
    """
    used = set()
    for photograph, grey in grey_names.items():
        with Image.open(grey_folder / grey) as image:
            size = image.size
        mask = np.full(size[::-1], 255, np.uint8)
        for name in (f"{photograph}.png", f"{grey}.png"):
            if not (masks / name).is_file():
                continue
            mask = _read_mask(masks, name, size)
            used.add(name)
            break
        write_bytes(out / f"{grey}.png", encode_png(mask))
    return used


def _read_mask(masks: Path, name: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    path = masks / name
    if leads_out(path, masks):
        raise ProjectError(
            f"{path}: a link that leads out of the folder of masks", hint="put the mask in its place"
        )
    try:
        with open_file(path) as file, Image.open(file, formats=MASKS) as image:
            if image.size != size:  # before its pixels are decoded, of which there may be too many
                raise ProjectError(
                    f"{path}: {image.width}x{image.height} pixels, its photograph has {size[0]}x{size[1]}",
                    hint="masks have the size of the photograph as stored, not turned upright",
                )
            return np.asarray(image.convert("L"))
    except _UNREADABLE_MASK as error:
        raise ProjectError(
            f"{path}: cannot be read as a mask ({error})", hint="save it as a PNG again"
        ) from error


def weights_for(capture: Capture, fit: Fit) -> Grey:
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


def _colour_twin(photograph: DecodedPhotograph, white: float) -> NDArray[np.uint8]:
    if photograph.srgb_from_camera is None:
        return np.asarray(photograph.rgb, np.uint8)
    return to_colour(np.asarray(photograph.rgb, np.uint16), photograph.srgb_from_camera, white)
