"""Say whether this machine is enough: for a project, and for how many photographs of how many megapixels."""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from colmap_ihe.machine import memory
from colmap_ihe.machine.memory import in_bytes
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline.estimates import most_bytes, needs_of, stage_parts
from colmap_ihe.pipeline.resource_needs import Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.project.options import Options

_SPARE_DISK = 1.2
_COSTS_ARE_FOR = 2  # cores
_MEGAPIXELS = (12, 24, 48)
_MOST = 20_000  # photographs; more were never tried
_TYPICAL = 100


def minutes_of(options: Options, size: PhotoSetSize) -> dict[str, float]:
    """Return the minutes that each stage, and the page, will take on the cores of this machine."""
    survey = {"images": size.images, "pixels": size.pixels, "raw": size.raw, "with_gps": size.with_gps}
    minutes: defaultdict[str, float] = defaultdict(float)
    for part in stage_parts(options, Known.from_records({"captures": survey}), STAGE_NAMES[-1]):
        minutes[part.stage] += part.seconds * _COSTS_ARE_FOR / local_workers() / 60
    return dict(minutes)


def about(minutes: float) -> str:
    """Return minutes in words, to be put behind what else a stage takes; empty for none."""
    if not minutes:
        return ""
    return f", about {_time(minutes)}"


def of_project(needs: Sequence[StageNeeds], disk_bytes: int, minutes: float, root: Path) -> str:
    """Say whether this machine is enough for stages that will write so many bytes into the folder `root`."""
    room, free = memory.available(), shutil.disk_usage(root).free
    short = _short_of_memory(needs, room)
    if short is not None:
        what = f"; {short.saves} helps" if short.saves else ""
        least = in_bytes(short.memory_bytes(1))
        return f"not enough: {short.stage} takes up to {least} of memory, and {in_bytes(room)} are free{what}"
    if disk_bytes * _SPARE_DISK > free:
        return f"not enough: the stages write about {in_bytes(disk_bytes)}, and {in_bytes(free)} are free on the disk"
    most = in_bytes(max(map(most_bytes, needs)))
    have = f" of {in_bytes(room)} free" if room else ""
    return (
        f"enough: up to {most} of memory{have}, {in_bytes(disk_bytes)} of {in_bytes(free)} free on the disk,"
        f" about {_time(minutes)}"
    )


def in_general(folder: Path) -> str:
    """Say for how many JPEG photographs of some sizes this machine is enough, with the default options, in a project on
    the disk of `folder`."""
    room, free, options = memory.available(), shutil.disk_usage(folder).free, Options()
    most = {megapixels: _most_photographs(options, megapixels, room, free) for megapixels in _MEGAPIXELS}
    if not most[_MEGAPIXELS[0]]:
        have = f"{in_bytes(room)} of memory and {in_bytes(free)} on the disk are free"
        return f"not enough for photographs of {_MEGAPIXELS[0]} megapixels: {have}"
    sizes = ", ".join(f"{count:,} of {megapixels} megapixels" for megapixels, count in most.items())
    minutes = sum(minutes_of(options, _set_of(_TYPICAL, 24)).values())
    larger = _short_of_memory(needs_of(options, _set_of(most[24] + 1, 24)), room)
    limit = "the disk" if larger is None else f"memory for {larger.stage}"
    return (
        f"enough for photographs, at the most: {sizes} ({limit} is the limit); {_TYPICAL} of 24 megapixels take about"
        f" {_time(minutes)}"
    )


def _most_photographs(options: Options, megapixels: int, room: int, free: int) -> int:
    """Return the most photographs that memory and disk have room for, by halving."""
    fits, too_many = 0, _MOST + 1
    while too_many - fits > 1:
        count = (fits + too_many) // 2
        needs = needs_of(options, _set_of(count, megapixels))
        disk = sum(need.disk_bytes for need in needs)
        if _short_of_memory(needs, room) is None and disk * _SPARE_DISK <= free:
            fits = count
        else:
            too_many = count
    return fits


def _set_of(images: int, megapixels: int) -> PhotoSetSize:
    pixels = megapixels * 1_000_000
    return PhotoSetSize(images, images * pixels, pixels, 0, 0, memory.JPEG_BYTES * pixels)


def _short_of_memory(needs: Sequence[StageNeeds], room: int) -> StageNeeds | None:
    """Return the stage that even one worker has no room for, None if all have."""
    worst = max(needs, key=lambda need: need.memory_bytes(1))
    return worst if room and worst.memory_bytes(1) > room else None


def _time(minutes: float) -> str:
    if minutes < 1:
        return "1 min"
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
