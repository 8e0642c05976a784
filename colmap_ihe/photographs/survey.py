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
    a RAW file's, else empty; `white_balance` of the shot of a linear photograph, else empty."""

    capture: Capture
    width: int
    height: int
    metadata: Metadata
    sensor: str = ""
    white_balance: tuple[float, ...] = ()


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
    header = read_size(capture)
    size = header.width, header.height
    linear = capture.kind == "coded" and bool(header.white_balance)
    seen = replace(capture, pixels=size[0] * size[1], recipe=replace(capture.recipe, linear=linear))
    metadata = filled_in(
        sized(read_metadata(capture.path, capture.kind), *size), cameras, capture.name, *size
    )
    return Surveyed(seen, *size, metadata, header.sensor, header.white_balance)
