"""Make the dense cloud of a sparse model: undistortion, depth maps, fusion, within the free memory."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.field_of_view import WIDEST_DEGREES
from colmap_ihe.dense.backend import patchmatch_depth_maps, pick_backend
from colmap_ihe.dense.cost import dense_cost
from colmap_ihe.dense.depth_maps import sgm_depth_maps
from colmap_ihe.dense.flat_parts import FlatPart
from colmap_ihe.dense.fusion import FUSION_BYTES, fuse
from colmap_ihe.dense.second_grey import add_second_grey
from colmap_ihe.dense.undistort import sizes_of, undistort
from colmap_ihe.errors import MappingError
from colmap_ihe.grey.second import SecondGrey
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import shares_memory, width_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.machine.words import counted, listed
from colmap_ihe.project.options import DenseOptions

logger = logging.getLogger(__name__)

_LEAST_FUSION = FUSION_BYTES // 16


def dense_cloud(
    sparse_model: Path,
    grey: Path,
    colour: Path,
    masks: Path,
    dense_dir: Path,
    options: DenseOptions,
    executor: Executor,
    progress: Progress,
    require_room: Callable[[int], None],
    second: SecondGrey | None = None,
) -> dict[str, Any]:
    """Make `dense_dir/fused.ply`, and return how, for the record. Existing depth maps are kept.

    The folder `masks` may be missing. `require_room` is called with the bytes that will be written, and may raise.
    The `second` grey adds to the pictures that stereo sees, not to those of COLMAP's workspace.
    Raises `MappingError` for a model of fewer than two images, and other `KnownError`s.
    """
    sizes = sizes_of(sparse_model, options.max_image_size)
    if len(sizes) < 2:
        raise MappingError(
            "dense stereo needs two registered photographs, the model has one",
            hint="look at the warnings of the sparse stage in records/sparse.json",
        )
    free = memory.available()
    cost = dense_cost(sizes, options.max_image_size, pick_backend(options.backend), local_workers(), free)
    logger.info("%s", cost.in_words())
    require_room(cost.disk_bytes)
    size = options.max_image_size
    folders = (sparse_model, grey, colour, dense_dir)
    parts = undistort(*folders, masks_dir=masks, max_image_size=size, progress=progress)
    if second is not None:
        add_second_grey(dense_dir, second, progress)
    record: dict[str, Any] = {"backend": cost.backend, "warnings": _cut_warnings(parts)}
    if cost.backend == "sgm":
        at_once = cost.at_once if shares_memory(executor) else 2 * width_of(executor)
        counts = sgm_depth_maps(dense_dir, executor=executor, at_once=at_once, progress=progress)
        for name in ("pixels", "pixels_with_depth", "pairs_used", "pairs_left_out"):
            record[name] = getattr(counts, name)
        if counts.empty:
            record["warnings"].append(f"no depth could be found for {listed(sorted(counts.empty))}")
    else:
        patchmatch_depth_maps(dense_dir, options=options.patchmatch, progress=progress)
    most = record["fusion_bytes"] = fusion_share(free)
    points = fuse(dense_dir, options=options.colmap, most_bytes=most, progress=progress)
    if not points:
        record["warnings"].append("no point of the depth maps was confirmed: the cloud is empty")
    return {**record, "points": points}


def _cut_warnings(parts: Mapping[str, FlatPart]) -> list[str]:
    """Name the photographs that are too wide, or whose model is too uncertain, to be laid flat as a whole."""
    cut = {name: part.share for name, part in sorted(parts.items()) if not part.is_whole}
    if not cut:
        return []
    return [
        f"dense stereo uses only the middle of {counted(len(cut), 'photograph')}, {min(cut.values()):.0%} of the pixels"
        f" or more: outside, the lens sees more than {WIDEST_DEGREES:.0f} degrees from its axis, or its calibration"
        f" does not hold: {listed(cut)}"
    ]


def fusion_share(free: int) -> int:
    """Return the bytes that fusion may hold where `free` are (0 for unknown): half of them at most, in steps of two.

    So other programs do not change how space is cut into cells.
    """
    most = FUSION_BYTES
    while 0 < free < 2 * most and most > _LEAST_FUSION:
        most //= 2
    return most
