"""Write the grey image and the colour twin of each photograph."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from colmap_ihe.errors import WeightsError
from colmap_ihe.fit.fit_set import Fit
from colmap_ihe.grey.convert import check_tone, to_colour, to_grey
from colmap_ihe.grey.wallis import wallis
from colmap_ihe.grey.weights import Grey
from colmap_ihe.machine import decoder_pool
from colmap_ihe.machine.executor import shares_memory
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.memory import at_once, keep_freed
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.decode import DecodedPhotograph, encoding_of, read_photograph, read_srgb
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut, each_usable
from colmap_ihe.photographs.encode import SUFFIXES, encode_image
from colmap_ihe.photographs.survey import Surveyed, survey
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.second_grey import UNIT, SecondGreyRecord, fit_second_grey
from colmap_ihe.pipeline.stage import NameBelow, Record, RunContext, Stage, StageRecord
from colmap_ihe.pipeline.stages.fit import fit_of
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import ConvertOptions, Options

_WAITING = 3
"""Files that wait for the disk, for each photograph at work: a disk that is slow now and then holds nobody up."""
_GREY_AND_COLOUR = {
    "png": {False: 2.9, True: 3.2},
    "tiff": {False: 4.1, True: 4.1},
    "jpeg": {False: 1.6, True: 2.0},
}
"""Bytes a pixel on disk, of photographs that are coded, or RAW and so with their noise."""


class ConvertRecord(StageRecord):
    """Name the grey image of each photograph, by its path in the folder of grey images; tell what that grey does not
    show, unless nobody asked."""

    grey: Annotated[dict[str, NameBelow], Field(min_length=1)]
    second: SecondGreyRecord | None = None


@dataclass(frozen=True)
class ImageWriter:
    """Write the grey images of photographs, and their colour twins unless the folder for these is None. With
    `keep_finished` what is there under its final name is left alone: the caller knows that it comes from the same
    input. `in_srgb`: twins are brought to sRGB, else they keep the profile of their photograph."""

    fit: Fit
    options: ConvertOptions
    grey_folder: Path
    colour_folder: Path | None
    keep_finished: bool
    in_srgb: bool = False

    def files_of(self, surveyed: Surveyed) -> Iterator[tuple[Path, bytes]]:
        """Yield the files of one photograph that are due, with their content."""
        name = grey_name(surveyed, self.options)
        grey_file = self.grey_folder / name
        colour_file = self.colour_folder / name if self.colour_folder else None
        grey_due = not (self.keep_finished and grey_file.exists())
        colour_due = colour_file is not None and not (self.keep_finished and colour_file.exists())
        if not grey_due and not colour_due:
            return
        keep_freed()
        photograph = read_photograph(surveyed.capture)
        exif, weights = surveyed.metadata.exif, weights_for(surveyed.capture, self.fit)
        if grey_due:
            grey = to_grey(photograph.rgb, weights, self.options.tone)
            if self.options.wallis:
                grey = wallis(grey)
            yield grey_file, encode_image(grey, exif, self.options.format)
        if colour_file is not None and colour_due:
            colour, profile = self._twin(photograph, surveyed)
            yield colour_file, encode_image(colour, exif, self.options.format, profile)

    def _twin(self, photograph: DecodedPhotograph, surveyed: Surveyed) -> tuple[NDArray[np.uint8], bytes]:
        """Return the colour twin, (H, W, 3) uint8, and the profile that it is in, empty for sRGB."""
        if photograph.srgb_from_camera is not None:
            rgb, gains = np.asarray(photograph.rgb, np.uint16), surveyed.capture.recipe.gains
            return to_colour(rgb, photograph.srgb_from_camera, self.fit.colour_white, gains), b""
        if self.in_srgb and surveyed.metadata.profile != "sRGB":
            return read_srgb(surveyed.capture, surveyed.metadata.profile), b""
        return np.asarray(photograph.rgb, np.uint8), b"" if self.in_srgb else photograph.profile

    def write(self, surveyed: Surveyed) -> str:
        """Write the files of one photograph that are due, and return its name."""
        for file, content in self.files_of(surveyed):
            write_bytes(file, content)
        return surveyed.capture.name


def run(run: RunContext, progress: Progress) -> ConvertRecord:
    """Write the grey images and colour twins that are due."""
    project = run.project
    for half_written in (*project.grey.rglob(".*.tmp"), *project.colour.rglob(".*.tmp")):
        half_written.unlink()
    fit = fit_of(run.records["fit"])
    captures = run.captures()
    surveyed = run.surveyed
    if not surveyed:
        cameras = run.options.cameras
        surveyed, _ = survey(captures, run.executor, progress, strict=run.strict, cameras=cameras)
    names = {c.name for c in captures}
    usable = [s for s in surveyed if s.capture.name in names]
    writer = ImageWriter(fit, run.options.convert, project.grey, project.colour, run.resumed, in_srgb=True)
    grey, left_out = convert_captures(usable, writer, run.executor, progress, run.strict)
    warnings = set_warnings.fit_warnings(captures, fit.weights.values())
    warnings += set_warnings.wallis_warnings(run.options.convert.wallis)
    # COLMAP, which comes next, has a use for their memory; one reads the EXIF of its cameras.
    decoder_pool.end_idle(kept=1)
    second = fit_second_grey(run, sorted(grey.values()), progress)
    return ConvertRecord(grey=grey, left_out=left_out, warnings=warnings, second=second)


def convert_captures(
    surveyed: Sequence[Surveyed], writer: ImageWriter, executor: Executor, progress: Progress, strict: bool
) -> tuple[dict[str, str], LeftOut]:
    """Write the grey image of every capture, with its EXIF, and its colour twin where a folder is given.

    Return the names of the grey images by capture, and what was left out. Raises as `survey`, `WeightsError` if the
    weights are for another encoding or cannot have the tone, `DiskFullError`.
    """
    for weights in writer.fit.weights.values():
        check_tone(weights, writer.options.tone)
    left_out: LeftOut = {}
    names = {s.capture.name: grey_name(s, writer.options) for s in surveyed}
    if not shares_memory(executor):
        done = list(each_usable(writer.write, surveyed, executor, progress, strict, left_out))
        return {name: names[name] for name in done}, left_out

    def converted_here(surveyed: Surveyed) -> tuple[str, list[Future[None]]]:
        files = writer.files_of(surveyed)
        return surveyed.capture.name, [disk.submit(write_bytes, file, content) for file, content in files]

    waiting: deque[Future[None]] = deque()
    most = _WAITING * at_once([s.capture for s in surveyed], local_workers())
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


def grey_name(photograph: Surveyed, options: ConvertOptions) -> str:
    """Return the name of its grey image, below the folder of them."""
    return photograph.capture.grey_stem + SUFFIXES[options.format]


def weights_for(capture: Capture, fit: Fit) -> Grey:
    """Return the weights that this photograph is converted with. Raises `WeightsError` if there are none."""
    encoding = encoding_of(capture)
    weights = fit.weights.get(encoding)
    if weights is None:
        raise WeightsError(
            f"{capture.name}: a {encoding} photograph, and the weights are for "
            f"{' and '.join(fit.weights)} ones",
            hint="fit weights on photographs of this kind; RAW is linear, JPEG is gamma-coded",
        )
    return weights


def _result_options(options: Options) -> dict[str, Any]:
    values = options.sections("convert")
    if options.fit.second != "none":
        values["convert"]["second"] = options.fit.second
    return values


def _files(project: Project, record: Record) -> list[Path]:
    return [folder / name for name in record["grey"].values() for folder in _made(project)]


def _made(project: Project) -> list[Path]:
    return [project.grey, project.colour]


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    share_raw = size.raw / max(1, size.images)
    of_format = _GREY_AND_COLOUR[options.convert.format]
    disk = size.pixels * (of_format[True] * share_raw + of_format[False] * (1 - share_raw))
    return StageNeeds("convert", BASE_BYTES, size.one_bytes, round(disk))


def _parts(options: Options, known: Known) -> list[Part]:
    parts = [Part("convert", "images", 0.015 * known.decoded_megapixels)]
    if options.fit.second != "none":
        parts.append(Part("convert", UNIT, 0.03e-6 * known.pixels))
    return parts


STAGE = Stage(
    "convert",
    run,
    ConvertRecord,
    sections=("convert",),
    result_options=_result_options,
    files=_files,
    made=_made,
    needs=_needs,
    parts=_parts,
)
