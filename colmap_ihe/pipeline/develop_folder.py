"""Write the RAW photographs of a folder as linear TIFFs of 16 bit; what is up to date is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.files import fingerprint_of, write_bytes
from colmap_ihe.machine.libraries import __version__, library_versions
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.each import LeftOut, each_usable, refused
from colmap_ihe.photographs.linear_tiff import encode_linear_tiff
from colmap_ihe.photographs.recipes import prepared_set
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.convert_folder import digests_of, require_apart
from colmap_ihe.pipeline.output_folder import Ledger, opened
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.project.options import DevelopOptions


def develop_folder(
    images: Path,
    out: Path,
    *,
    options: DevelopOptions | None = None,
    calibration: Path | None = None,
    strict: bool = False,
    progress: RunProgress = SILENT,
) -> tuple[dict[str, str], dict[str, list[str]], LeftOut]:
    """Write a TIFF of each RAW file in the folder `images`, with its EXIF, in the folder `out`: RGB of the sensor,
    linear, 65535 at its saturation, not turned. Photographs that are no RAW files are passed over, with a warning.

    `calibration`: a folder with calibration frames. Return the names of the TIFFs by photograph, the steps of
    development by camera, and what was left out. Raises as `convert_folder`.
    """
    require_apart(images.resolve(), [out.resolve()])
    discovery = discover(images.absolute())
    not_read = refused(discovery.refused, strict)
    raw = [c for c in discovery.captures if c.kind == "raw"]
    if not raw:
        raise ProjectError(
            f"{images}: none of its {len(discovery.captures)} photographs is a RAW file",
            hint="others are developed already: use them as they are",
        )
    with ExitStack() as stack:
        executor = stack.enter_context(local_executor())
        prepared = stack.enter_context(
            prepared_set(raw, options, calibration, executor, progress, strict=strict)
        )
        for text in set_warnings.warnings_of(prepared.surveyed, discovery.ignored):
            progress.warn(text)
        if len(raw) < len(discovery.captures):
            progress.warn(f"{len(discovery.captures) - len(raw)} photographs are no RAW files: passed over")
        digests = digests_of(prepared.surveyed, executor, progress)
        ledger = stack.enter_context(opened(out.resolve()))
        names, failed = _develop(prepared.surveyed, digests, ledger, executor, progress, strict)
    left_out = not_read | prepared.left_out | failed
    for reason in left_out.values():
        progress.warn(f"left out: {reason}")
    return {n: t for n, t in names.items() if n not in left_out}, prepared.steps, left_out


def _develop(
    surveyed: Sequence[Surveyed],
    digests: Mapping[str, str],
    ledger: Ledger,
    executor: Executor,
    progress: RunProgress,
    strict: bool,
) -> tuple[dict[str, str], LeftOut]:
    """Write the TIFFs that are not up to date; return the names of all by photograph, and what was left out."""
    names = {s.capture.name: f"{s.capture.grey_stem}.tif" for s in surveyed}
    expected = {tiff: name for name, tiff in names.items()}
    ledger.refuse(expected)
    versions = library_versions("rawpy", "libraw")
    prints = {
        names[c.name]: fingerprint_of(__version__, versions, digests[c.name], c.recipe.identity())
        for c in (s.capture for s in surveyed)
    }
    due = {expected[tiff] for tiff in ledger.begin(expected, prints)}
    left_out: LeftOut = {}

    if due:
        with progress.stage("develop") as stage_progress:
            stale = [s for s in surveyed if s.capture.name in due]
            develop = partial(_develop_one, ledger.folder)
            for _ in each_usable(develop, stale, executor, stage_progress, strict, left_out):
                pass
    else:
        progress.kept("develop")
    ledger.end()
    return names, left_out


def _develop_one(folder: Path, photograph: Surveyed) -> None:
    linear_rgb = np.asarray(read_photograph(photograph.capture).rgb, np.uint16)
    tiff = encode_linear_tiff(linear_rgb, photograph.metadata.exif)
    write_bytes(folder / f"{photograph.capture.grey_stem}.tif", tiff)
