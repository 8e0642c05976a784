"""Whether memory and disk have room for what remains of a run, told before it begins."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence

from colmap_ihe.errors import DiskFullError
from colmap_ihe.machine import memory
from colmap_ihe.machine.memory import in_bytes
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.resource_needs import StageNeeds
from colmap_ihe.project.folder import Project

_CERTAIN = 0.65
"""Of what is estimated: with less the disk is too small, however much less than the estimate this set takes."""
_CLOSE = 1.2
_INSTEAD = {
    "captures": "",
    "fit": "",
    "convert": "",
    "features": "a smaller features.max_image_size, ",
    "matches": "a smaller features.colmap.sift.max_num_features, ",
    "sparse": "a smaller features.colmap.sift.max_num_features, ",
    "dense": "a smaller dense.max_image_size, ",
    "mesh": "fewer mesh.faces, ",
    "page": "",
}


def disk_left(project: Project, demands: Sequence[StageNeeds], stages: Collection[str]) -> dict[str, int]:
    """Bytes that each of these stages will write besides what it left before, which is kept or goes first."""
    wanted = [demand for demand in demands if demand.stage in stages]
    return {one.stage: max(0, one.disk_bytes - outputs.bytes_of(one.stage, project)) for one in wanted}


def disk_warnings(project: Project, demands: Sequence[StageNeeds], stages: Collection[str]) -> list[str]:
    """What its owner should know. Raises `DiskFullError` where the disk is certainly too small."""
    left = disk_left(project, demands, stages)
    need, free = sum(left.values()), shutil.disk_usage(project.root).free
    if need * _CLOSE <= free:
        return []
    most = ", ".join(
        f"{name} {in_bytes(size)}" for name, size in sorted(left.items(), key=_by_size)[:3] if size
    )
    said = f"{project.root}: {in_bytes(free)} free on this disk, about {in_bytes(need)} needed ({most})"
    if free < need * _CERTAIN:
        raise DiskFullError(said, hint="make room; the same command goes on from here")
    return [f"{said}: it may become full; the same command goes on then"]


def memory_warnings(demand: StageNeeds) -> list[str]:
    """What its owner should know where even one worker of a stage may find too little. It is tried all the same: the
    estimate is for the worst."""
    free, here = memory.available(), memory.taken("self")[0]
    need = demand.memory_bytes(1)
    if not free or need <= free + here:
        return []
    return [
        f"{demand.stage} takes up to {in_bytes(need)} of memory, and there are {in_bytes(free + here)}: it may end for"
        f" want of it; {_INSTEAD[demand.stage]}fewer other programs or a higher limit help"
    ]


def in_words(demand: StageNeeds) -> str:
    """Of memory as many workers take as there are cores, or as there is room for."""
    workers = memory.most_at_once(demand.one_bytes, memory.available(), local_workers())
    words = [
        f"{in_bytes(max(demand.memory_bytes(workers), demand.base_bytes + demand.more_bytes))} of memory"
    ]
    return ", ".join([*words, f"{in_bytes(demand.disk_bytes)} on disk"] if demand.disk_bytes else words)


def _by_size(entry: tuple[str, int]) -> int:
    return -entry[1]
