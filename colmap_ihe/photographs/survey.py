"""Headers of photographs: sizes, EXIF, and what is known of their cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.decode import read_size
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut, each_usable
from colmap_ihe.photographs.exif.metadata import Metadata, read_metadata, sized
from colmap_ihe.photographs.known_cameras import filled_in
from colmap_ihe.project.options import CamerasOptions


@dataclass(frozen=True)
class Surveyed:
    """Hold a capture with what its header says, its number of pixels among it; sizes in pixels. `sensor`: the kind of
    a RAW file's, else empty."""

    capture: Capture
    width: int
    height: int
    metadata: Metadata
    sensor: str = ""


def survey(
    captures: Sequence[Capture],
    executor: Executor,
    progress: Progress,
    *,
    strict: bool,
    cameras: CamerasOptions | None = None,
    refused: Mapping[str, str] | None = None,
) -> tuple[list[Surveyed], LeftOut]:
    """Return sizes and EXIF of all captures, with what is known of their cameras, and what is left out, by name:
    what was `refused` before among it. Raises `PhotographError` if strict, `ProjectError` if none is usable."""
    left_out: LeftOut = dict(refused or {})
    look = partial(_survey_one, cameras or CamerasOptions())
    return list(each_usable(look, captures, executor, progress, strict, left_out)), left_out


def _survey_one(cameras: CamerasOptions, capture: Capture) -> Surveyed:
    width, height, sensor = read_size(capture)
    seen = replace(capture, pixels=width * height)
    metadata = sized(read_metadata(capture.path, capture.kind), width, height)
    return Surveyed(seen, width, height, filled_in(metadata, cameras, capture.name, width, height), sensor)
