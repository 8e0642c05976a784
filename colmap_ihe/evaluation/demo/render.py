"""Render the demo to disk: photographs of the portico and the truth about them.

    FOLDER/images/STEM.dng, STEM.jpg    RAW and JPEG of each shot
    FOLDER/truth/STEM.depth.png         16-bit grey, what each pixel centre sees: 0 nothing, else
                                        65535 * nearest_m / depth_m
    FOLDER/control/                     surveyed targets, if the photographs are large enough to show them (targets.py)
    FOLDER/truth/cameras.json           written last; `colmap_ihe.evaluation.truth` reads it

cameras.json holds
    render      what was asked for, the version of the scene, and how many targets are in it, if any
    extent_m    diagonal of the bounding box of everything that some view sees
    cameras     by stem: width, height; calibration (3 x 3, the centre of the top left pixel is
                (0.5, 0.5)); cam_from_world (3 x 4, metres, camera x right, y down, z forward);
                depth (file name), nearest_m
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from colmap_ihe.evaluation.demo.camera import take_photograph
from colmap_ihe.evaluation.demo.grid import F32
from colmap_ihe.evaluation.demo.raycast import Surface, bake, render
from colmap_ihe.evaluation.demo.scene import portico
from colmap_ihe.evaluation.demo.targets import LEAST_WIDTH, TARGETS, control_files, target_patches
from colmap_ihe.evaluation.demo.views import DemoView, arc_of_views
from colmap_ihe.machine.files import write_bytes, write_json
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import one_blas_thread

_SCENE_VERSION = 1  # raise it whenever the same parameters give other pictures
_TEXEL_M = 0.0075  # for pictures 1504 wide: about what a pixel sees of the facade
_THREADS = 4  # each holds about 200 MB at full size


def render_demo(
    folder: Path,
    *,
    views: int = 14,
    size: tuple[int, int] = (1504, 1000),
    seed: int = 0,
    progress: Progress = SILENT,
) -> None:
    """Write the demo to `folder`, unless the same demo is there already and complete.

    `size` is (width, height) in pixels, both even. Raises ValueError for what cannot be rendered,
    `DiskFullError` where the disk is full, `Cancelled` when `progress` asks to stop: the demo is
    then incomplete, and the next call renders it again.
    """
    if views < 2 or any(n < 16 or n % 2 for n in size):
        expected = "at least 2 views and an even width and height of 16 or more"
        raise ValueError(f"{views=}, {size=}, expected {expected}")
    asked: dict[str, Any] = {"scene": _SCENE_VERSION, "views": views, "size": list(size), "seed": seed}
    has_targets = max(size) >= LEAST_WIDTH
    if has_targets:
        asked["targets"] = len(TARGETS)
    cameras_file = folder / "truth" / "cameras.json"
    arc = arc_of_views(views, size)
    progress.start(views + 1)
    if _is_complete(folder, asked, arc):
        progress.advance(views + 1)
        return
    cameras_file.unlink(missing_ok=True)
    with one_blas_thread(), ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
        scene = portico() + (target_patches() if has_targets else ())
        surfaces = bake(scene, _TEXEL_M * 1504 / max(size), seed, pool)
        progress.advance()
        jobs = [pool.submit(_shoot, surfaces, view, shot, folder, seed) for shot, view in enumerate(arc)]
        try:
            shots = []
            for job in jobs:
                shots.append(job.result())
                progress.advance()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    for name, text in control_files(seed).items() if has_targets else ():
        write_bytes(folder / "control" / name, text.encode())
    bounds = np.stack([box for _, box in shots])
    extent_m = float(np.linalg.norm(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))
    cameras = {view.stem: record for view, (record, _) in zip(arc, shots, strict=True)}
    write_json(cameras_file, {"render": asked, "extent_m": extent_m, "cameras": cameras})


def _shoot(
    surfaces: Sequence[Surface], view: DemoView, shot: int, folder: Path, seed: int
) -> tuple[dict[str, Any], F32]:
    """Render and write one view. Return its record in cameras.json and the box (2, 3) it sees."""
    rendering = render(surfaces, view)
    take_photograph(rendering.radiance, view, shot, folder / "images", seed)
    seen = rendering.depth > 0
    nearest_m = float(rendering.depth[seen].min()) if seen.any() else 1.0
    code = np.zeros(rendering.depth.shape, np.uint16)
    code[seen] = np.rint(65535 * np.float32(nearest_m) / rendering.depth[seen])
    depth_file = folder / "truth" / f"{view.stem}.depth.png"
    png = BytesIO()
    Image.fromarray(code).save(png, "PNG", compress_level=4)
    write_bytes(depth_file, png.getvalue())
    record = {
        "width": view.width,
        "height": view.height,
        "calibration": view.calibration.tolist(),
        "cam_from_world": view.cam_from_world.tolist(),
        "depth": depth_file.name,
        "nearest_m": nearest_m,
    }
    return record, _visible_box(rendering.depth, view)


def _visible_box(depth: F32, view: DemoView) -> F32:
    """Return (2, 3): least and greatest world coordinates of what the view sees."""
    row, column = np.nonzero(depth)
    z = depth[row, column]
    x = (column + 0.5 - view.width / 2) / view.focal_px * z
    y = (row + 0.5 - view.height / 2) / view.focal_px * z
    world = np.stack((x, y, z), axis=1) @ view.cam_from_world[:, :3] + view.centre
    return np.stack((world.min(axis=0), world.max(axis=0)))


def _is_complete(folder: Path, asked: dict[str, Any], arc: Sequence[DemoView]) -> bool:
    """Tell whether all files are there. cameras.json is written last: after it files can only have been deleted."""
    try:
        rendered = json.loads((folder / "truth" / "cameras.json").read_text())["render"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    files = [f"images/{v.stem}{suffix}" for v in arc for suffix in (".dng", ".jpg")]
    files += [f"truth/{v.stem}.depth.png" for v in arc]
    files += [f"control/{name}" for name in control_files(asked["seed"])] if "targets" in asked else []
    return bool(rendered == asked) and all((folder / name).is_file() for name in files)
