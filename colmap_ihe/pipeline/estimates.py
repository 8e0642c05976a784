"""Estimate what the stages of a run, and the page after them, need of memory, disk and time; tell before a run begins
whether memory and disk have room for what remains of it."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence

from colmap_ihe.errors import DiskFullError
from colmap_ihe.machine import memory
from colmap_ihe.machine.memory import in_bytes
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.pipeline.stages.dense import POINTS_A_PIXEL, pixels_seen
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_PAGE = 8_000_000  # bytes on disk
_POINT, _PIXEL = 150, 75  # bytes of memory, a point of the cloud and a pixel of the photographs of a pair
_CERTAIN = 0.65
"""Share of the estimate: with less room the disk is too small, however much less than the estimate this set takes."""
_CLOSE = 1.2


def needs_of(options: Options, size: PhotoSetSize) -> list[StageNeeds]:
    """Return the needs of every stage that is not switched off, in their order, and of the page."""
    needs = [stage.needs(options, size) for stage in STAGES if not stage.switched_off(options)]
    points = POINTS_A_PIXEL * pixels_seen(options, size) if options.dense.enabled else 0.0
    page = StageNeeds("page", BASE_BYTES + round(_POINT * points), round(_PIXEL * size.largest), _PAGE)
    return [*(need for need in needs if need is not None), page]


def stage_parts(options: Options, known: Known, until: str) -> list[Part]:
    """Return the parts of the stages after `captures` up to the end of `until`, with those of the page, which follows
    where there is a model. Measured with `benchmarks/remaining.py`."""
    parts: list[Part] = []
    for stage in STAGES:
        if not stage.switched_off(options):
            parts += stage.parts(options, known)
        if stage.name == until:
            break
    if any(part.stage == "sparse" for part in parts):
        megapixels = known.pixels / 1e6
        parts += [
            Part("page", "photographs looked at", 0.045 * megapixels),
            Part("page", "pairs drawn", 2.5 + 0.8 * megapixels / known.images),
        ]
    return parts


def disk_left(project: Project, needs: Sequence[StageNeeds], names: Collection[str]) -> dict[str, int]:
    """Return the bytes that each stage of these names will write besides what it left before."""
    there = bytes_on_disk(project)
    return {need.stage: max(0, need.disk_bytes - there[need.stage]) for need in needs if need.stage in names}


def bytes_on_disk(project: Project) -> dict[str, int]:
    """Return the bytes that each stage, and the page, has left in a project, by name."""
    return {
        **{stage.name: sum(map(outputs.size_of, stage.made(project))) for stage in STAGES},
        "page": outputs.size_of(project.report),
    }


def disk_warnings(project: Project, needs: Sequence[StageNeeds], names: Collection[str]) -> list[str]:
    """Warn of a disk that may become full. Raises `DiskFullError` where it is certainly too small."""
    left = disk_left(project, needs, names)
    need, free = sum(left.values()), shutil.disk_usage(project.root).free
    if need * _CLOSE <= free:
        return []
    largest = sorted(left.items(), key=lambda entry: -entry[1])[:3]
    most = ", ".join(f"{name} {in_bytes(size)}" for name, size in largest if size)
    text = f"{project.root}: {in_bytes(free)} free on this disk, about {in_bytes(need)} needed ({most})"
    if free < need * _CERTAIN:
        raise DiskFullError(text, hint="make room; the same command goes on from here")
    return [f"{text}: it may become full; the same command goes on then"]


def memory_warnings(needs: StageNeeds) -> list[str]:
    """Warn where even one worker may find too little memory; it is tried all the same, as the worst is estimated."""
    free, taken = memory.available(), memory.taken("self")[0]
    need = needs.memory_bytes(1)
    if not free or need <= free + taken:
        return []
    saves = f"{needs.saves}, " if needs.saves else ""
    return [
        f"{needs.stage} takes up to {in_bytes(need)} of memory, and there are {in_bytes(free + taken)}: it may end for"
        f" want of it; {saves}fewer other programs or a higher limit help"
    ]


def most_bytes(needs: StageNeeds) -> int:
    """Return the memory of a stage with as many workers as there are cores, or as there is memory for."""
    workers = memory.most_at_once(needs.one_bytes, memory.available(), local_workers())
    return max(needs.memory_bytes(workers), needs.base_bytes + needs.more_bytes)


def in_words(needs: StageNeeds) -> str:
    """Describe needs with as many workers as there are cores, or as there is memory for."""
    most = most_bytes(needs)
    disk = f", {in_bytes(needs.disk_bytes)} on disk" if needs.disk_bytes else ""
    return f"{in_bytes(most)} of memory{disk}"
