"""Depth maps to one coloured cloud, by COLMAP, in as much memory as is allowed: one cell of space at a time."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.colmap.cells import Cell, Seen, cells_of
from colmap_ihe.colmap.depth_maps import depth_file, read_depth
from colmap_ihe.colmap.native import apply_options, called, pycolmap
from colmap_ihe.colmap.ply import read_ply, row_header
from colmap_ihe.progress import SILENT, Watch

FUSION_BYTES = 2_000_000_000
"""What fusion may hold at a time; more where all images see the same."""
FUSION_BYTES_A_PIXEL = 75
"""Depth, normal, colour and a mark, 23, and the points that come of it. Measured with benchmarks/dense.py."""

# Every pixel of our depth maps was confirmed by other photographs, so that two maps that agree are enough
# (COLMAP asks for five). Within less than a pixel, so that the cloud keeps the images' resolution: COLMAP's
# two pixels leave about half of the points. Depth and normals are checked as COLMAP does.
FUSION_DEFAULTS: Mapping[str, Any] = {"min_num_pixels": 2, "max_reproj_error": 0.75}

_SAMPLES = 1500  # of an image, for the cells
_SHARED = ("images", "sparse", "masks", "stereo/depth_maps", "stereo/normal_maps")


def fuse(
    dense_dir: Path,
    *,
    options: Mapping[str, Any] | None = None,
    most_bytes: int = FUSION_BYTES,
    watch: Watch = SILENT,
) -> int:
    """Fuses the depth maps to the coloured cloud `dense_dir/fused.ply`; returns its number of points.

    `options` goes to pycolmap.StereoFusionOptions, over `FUSION_DEFAULTS`. Masks in `dense_dir/masks` are respected.
    Where all maps together take more than `most_bytes`, space is fused in cells.
    """
    native = fusion_options(options or {})
    if (dense_dir / "masks").is_dir():
        native.mask_path = dense_dir / "masks"
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    ids = sorted(model.reg_image_ids())
    costs = np.array([_pixels(model, i) * FUSION_BYTES_A_PIXEL for i in ids], float)
    cells = [] if costs.sum() <= most_bytes else cells_of(_seen(dense_dir, model, ids), costs, most_bytes)
    part = dense_dir / "fused.part.ply"
    watch.start(max(1, len(cells)), "fusions")
    if len(cells) < 2:
        points = _fused(dense_dir, part, native, watch)
        watch.advance()
    else:
        names = [model.images[i].name for i in ids]
        points = _fused_in_cells(dense_dir, part, native, cells, names, watch)
    for suffix in (".vis", ""):
        part.with_name(part.name + suffix).replace(dense_dir / f"fused.ply{suffix}")
    return points


def fusion_options(values: Mapping[str, Any]) -> pycolmap.StereoFusionOptions:
    """`FUSION_DEFAULTS` with `values` over them. Raises `OptionError`."""
    native = pycolmap.StereoFusionOptions(**FUSION_DEFAULTS)
    apply_options(native, values, "dense.colmap")
    return native


def _pixels(model: pycolmap.Reconstruction, image_id: int) -> int:
    camera = model.cameras[model.images[image_id].camera_id]
    return int(camera.width * camera.height)


def _fused(workspace: Path, out: Path, options: pycolmap.StereoFusionOptions, watch: Watch) -> int:
    cloud = called(pycolmap.stereo_fusion, out, workspace, options=options, output_type="ply", watch=watch)
    return int(cloud.num_points3D())


def _seen(dense_dir: Path, model: pycolmap.Reconstruction, ids: Sequence[int]) -> Seen:
    """What the depth maps show, on a coarse grid."""
    points, images, distances = [], [], []
    for place, image_id in enumerate(ids):
        image = model.images[image_id]
        file = depth_file(dense_dir, image.name)
        if not file.is_file():
            continue
        depth = read_depth(file)
        step = max(1, int((depth.size / _SAMPLES) ** 0.5))
        rows, columns = np.nonzero(depth[::step, ::step])
        held = depth[::step, ::step][rows, columns].astype(float)
        camera = model.cameras[image.camera_id]
        pixels = np.stack([columns * step + 0.5, rows * step + 0.5, np.ones(len(rows))], axis=1)
        rays = pixels @ np.linalg.inv(camera.calibration_matrix()).T
        points.append(image.cam_from_world().inverse() * (rays * held[:, None]))
        images.append(np.full(len(rows), place))
        distances.append(held)
    if not points:
        return Seen(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0))
    return Seen(np.concatenate(points), np.concatenate(images), np.concatenate(distances))


def _fused_in_cells(
    dense_dir: Path,
    out: Path,
    options: pycolmap.StereoFusionOptions,
    cells: Sequence[Cell],
    names: Sequence[str],
    watch: Watch,
) -> int:
    """One cell after the other, each in a workspace of links of its own; what lies in it goes to `out`."""
    bounds = [side.copy() for side in options.bounding_box]  # else views of what is set below
    rows_file, seen_file = (out.with_name(f"{out.name}.{word}") for word in ("rows", "seen"))
    work = dense_dir / "stereo" / ".cell"
    count, dtype = 0, np.dtype([])
    try:
        with rows_file.open("wb") as all_rows, seen_file.open("wb") as all_seen:
            for cell in cells:
                shutil.rmtree(work, ignore_errors=True)
                _link(dense_dir, work, [names[i] for i in cell.images])
                box = (cell.low - cell.margin, cell.high + cell.margin)
                low, high = (np.clip(side, *bounds).astype(np.float32) for side in box)
                options.bounding_box = (low, high)
                _fused(work, work / "fused.ply", options, watch)
                rows = read_ply(work / "fused.ply")["vertex"]
                held = cell.holds(np.stack([rows[axis] for axis in "xyz"], axis=1))
                all_rows.write(rows[held].tobytes())
                all_seen.write(_visibility(work / "fused.ply.vis", held))
                count, dtype = count + int(held.sum()), rows.dtype
                watch.advance()
        _joined(out, row_header(count, dtype), rows_file)
        _joined(out.with_name(out.name + ".vis"), np.uint64(count).tobytes(), seen_file)
    finally:
        for left in (rows_file, seen_file):
            left.unlink(missing_ok=True)
        shutil.rmtree(work, ignore_errors=True)
    return count


def _link(dense_dir: Path, work: Path, names: Sequence[str]) -> None:
    """A workspace in which COLMAP finds what is in `dense_dir`, and fuses the images of these names."""
    for shared in _SHARED:
        if (dense_dir / shared).is_dir():
            (work / shared).parent.mkdir(parents=True, exist_ok=True)
            (work / shared).symlink_to((dense_dir / shared).resolve(), target_is_directory=True)
    (work / "stereo" / "fusion.cfg").write_text("".join(f"{name}\n" for name in names), encoding="utf-8")


def _visibility(file: Path, held: np.ndarray[Any, np.dtype[np.bool_]]) -> bytes:
    """The lists of a .vis file (COLMAP, `mvs/fusion.cc`: a count, then the images, of each point) of points `held`."""
    words = np.fromfile(file, "<u4", offset=8)
    starts, place = np.empty(len(held) + 1, np.intp), 0
    for row in range(len(held)):
        starts[row] = place
        place += 1 + int(words[place])
    starts[len(held)] = place
    return words[np.repeat(held, np.diff(starts))].tobytes()


def _joined(out: Path, head: bytes, body: Path) -> None:
    with out.open("wb") as target, body.open("rb") as source:
        target.write(head)
        shutil.copyfileobj(source, target, 1 << 24)
