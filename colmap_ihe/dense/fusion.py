"""Fuse depth maps to one coloured cloud, by COLMAP, within the memory allowed: one cell of space at a time."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.colmap.native import apply_options, called, pycolmap
from colmap_ihe.dense.camera import Bool
from colmap_ihe.dense.fusion_cell_workspace import Maps
from colmap_ihe.dense.fusion_cells import Cell, Price, cells_of
from colmap_ihe.dense.ply import columns, read_ply, row_header
from colmap_ihe.machine.files import replace_file
from colmap_ihe.machine.progress import SILENT, Progress

FUSION_BYTES = 1_600_000_000
"""Bytes that fusion may hold at a time."""
PRICE = Price(map=33, point=50)
"""Bytes a pixel: `map`: its depth, normal, colour and marks; `point`: what is made of it, 280 a point, where five or
six pixels make a point. Measured with benchmarks/dense.py."""

# Every pixel of our depth maps was confirmed by other photographs, so that two maps that agree are enough
# (COLMAP asks for five). Within less than a pixel, so that the cloud keeps the images' resolution: COLMAP's
# two pixels leave about half of the points. Depth and normals are checked as COLMAP does.
FUSION_DEFAULTS: Mapping[str, Any] = {"min_num_pixels": 2, "max_reproj_error": 0.75}


def fuse(
    dense_dir: Path,
    *,
    options: Mapping[str, Any] | None = None,
    most_bytes: int = FUSION_BYTES,
    progress: Progress = SILENT,
) -> int:
    """Fuse the depth maps to the coloured cloud `dense_dir/fused.ply`; return its number of points.

    `options` goes to pycolmap.StereoFusionOptions, over `FUSION_DEFAULTS`. Masks in `dense_dir/masks` are respected.
    Where all maps together take more than `most_bytes`, space is fused in cells.
    """
    native = fusion_options(options or {})
    maps = Maps(dense_dir)
    cells = cells_of(maps.coverage(), PRICE, most_bytes) if fusion_bytes(maps.pixels) > most_bytes else []
    part = dense_dir / "fused.part.ply"
    progress.start(max(1, len(cells)), "fusions")
    if len(cells) < 2:
        points = _fused(dense_dir, part, native, progress)
        progress.advance()
    else:
        points = _fused_in_cells(maps, part, native, cells, progress)
    for suffix in (".vis", ""):
        replace_file(part.with_name(part.name + suffix), dense_dir / f"fused.ply{suffix}")
    return points


def fusion_bytes(pixels: int) -> int:
    """Return the bytes that fusing images with so many pixels takes in one piece, at most."""
    return int((PRICE.map + PRICE.point) * pixels)


def fusion_options(values: Mapping[str, Any]) -> pycolmap.StereoFusionOptions:
    """Return `FUSION_DEFAULTS` with `values` over them. Raises `OptionError`."""
    return apply_options(pycolmap.StereoFusionOptions(**FUSION_DEFAULTS), values, "dense.colmap")


def _fused(workspace: Path, out: Path, options: pycolmap.StereoFusionOptions, progress: Progress) -> int:
    if (workspace / "masks").is_dir():
        options.mask_path = workspace / "masks"
    cloud = called(
        pycolmap.stereo_fusion, out, workspace, options=options, output_type="ply", progress=progress
    )
    return int(cloud.num_points3D())


def _fused_in_cells(
    maps: Maps, out: Path, options: pycolmap.StereoFusionOptions, cells: Sequence[Cell], progress: Progress
) -> int:
    """Fuse one cell after the other, each in a workspace of its own; keep the points that lie in the cell."""
    bounds = [side.copy() for side in options.bounding_box]  # else views of what is set below
    rows_file, seen_file = (out.with_name(f"{out.name}.{word}") for word in ("rows", "seen"))
    work = maps.dense_dir / "stereo" / ".cell"
    count, dtype = 0, np.dtype([])
    try:
        with rows_file.open("wb") as all_rows, seen_file.open("wb") as all_seen:
            for cell in cells:
                images = maps.write_cell(cell, work)
                box = (cell.low - cell.margin, cell.high + cell.margin)
                low, high = (np.clip(side, *bounds).astype(np.float32) for side in box)
                options.bounding_box = (low, high)
                _fused(work, work / "fused.ply", options, progress)
                rows = read_ply(work / "fused.ply")["vertex"]
                held = cell.holds(columns(rows, "xyz"))
                all_rows.write(rows[held].tobytes())
                all_seen.write(_visibility(work / "fused.ply.vis", held, images))
                count, dtype = count + int(held.sum()), rows.dtype
                progress.advance()
        _joined(out, row_header(count, dtype), rows_file)
        _joined(out.with_name(out.name + ".vis"), np.uint64(count).tobytes(), seen_file)
    finally:
        for file in (rows_file, seen_file):
            file.unlink(missing_ok=True)
        shutil.rmtree(work, ignore_errors=True)
    return count


def _visibility(file: Path, held: Bool, images: Sequence[int]) -> bytes:
    """Return the lists of a .vis file (COLMAP, `mvs/fusion.cc`: a count, then the images, of each point) of the points
    `held`; `images` are the indices of the cell's images in the whole set."""
    words = np.fromfile(file, "<u4", offset=8)
    starts = np.zeros(len(held) + 1, np.intp)
    for row in range(len(held)):
        starts[row + 1] = starts[row] + 1 + int(words[starts[row]])
    is_count = np.zeros(len(words), bool)
    is_count[starts[:-1]] = True
    words[~is_count] = np.array(images, "<u4")[words[~is_count]]
    return words[np.repeat(held, np.diff(starts))].tobytes()


def _joined(out: Path, head: bytes, body: Path) -> None:
    with out.open("wb") as target, body.open("rb") as source:
        target.write(head)
        shutil.copyfileobj(source, target, 1 << 24)
