"""Tell before a run begins whether memory and disk have room for what remains of it."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence

from colmap_ihe.errors import DiskFullError
from colmap_ihe.machine import memory
from colmap_ihe.machine.memory import in_bytes
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.resource_needs import StageNeeds
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project

_CERTAIN = 0.65
"""Share of the estimate: with less room the disk is too small, however much less than the estimate this set takes."""
_CLOSE = 1.2


def disk_left(project: Project, needs: Sequence[StageNeeds], names: Collection[str]) -> dict[str, int]:
    """Return the bytes that each stage of these names will write besides what it left before, which is kept or goes
    first."""
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
    """Warn where even one worker of a stage may find too little memory. It is tried all the same: the estimate is for
    the worst."""
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
