"""Write the RAW photographs of a folder as linear TIFFs of 16 bit; what is up to date is kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from colmap_ihe.machine.files import fingerprint_of, write_bytes
from colmap_ihe.machine.libraries import __version__, library_versions
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut, each_usable
from colmap_ihe.photographs.linear_tiff import encode_linear_tiff
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.output_folder import FolderRun, folder_run
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
    with folder_run(images, [out], options, calibration, strict, progress, raw_only=True) as run:
        names = {s.capture.name: f"{s.capture.grey_stem}.tif" for s in run.surveyed}
        due = _due(run, {tiff: name for name, tiff in names.items()})
        if due:
            with progress.stage("develop") as stage_progress:
                develop = partial(_develop_one, run.ledgers[0].folder)
                for _ in each_usable(develop, due, run.executor, stage_progress, strict, run.left_out):
                    pass
        else:
            progress.kept("develop")
        run.ledgers[0].end()
    return {n: t for n, t in names.items() if n not in run.left_out}, run.steps, run.left_out


def _due(run: FolderRun, expected: Mapping[str, str]) -> list[Surveyed]:
    """Return the photographs whose TIFFs are not up to date. `expected`: the photograph of each TIFF."""
    ledger = run.ledgers[0]
    ledger.refuse(expected)
    recipes = {s.capture.name: _own(s).recipe.identity() for s in run.surveyed}
    versions = library_versions("rawpy", "libraw")
    prints = {
        tiff: fingerprint_of(__version__, versions, run.digests[name], recipes[name])
        for tiff, name in expected.items()
    }
    due = {expected[tiff] for tiff in ledger.begin(expected, prints)}
    return [s for s in run.surveyed if s.capture.name in due]


def _develop_one(folder: Path, photograph: Surveyed) -> None:
    decoded = read_photograph(_own(photograph))
    rgb = np.asarray(decoded.rgb, np.uint16)
    tiff = encode_linear_tiff(rgb, photograph.metadata.exif, decoded.srgb_from_camera)
    write_bytes(folder / f"{photograph.capture.grey_stem}.tif", tiff)


def _own(photograph: Surveyed) -> Capture:
    """Return the capture with the white balance of its shot: that of the set is found where the TIFF is used."""
    return replace(photograph.capture, recipe=photograph.capture.recipe.unbalanced())
