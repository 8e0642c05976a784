"""Reconstruct three rendered sets with COLMAP's default grey alone and as we do by default, side by side.

    python benchmarks/painted_sets.py [--sets brick mosaic ceiling] [--views 8]

The demo's renderer with other walls: brick and tile, where all is seen in grey; a wall with three mosaics in two
colours of one Rec.709 grey each, among plaster; a painted ceiling, six panels of a coffered frieze. Photographs are
the demo's JPEGs. "on paintings" are points of the sparse model within 3 cm of a painted surface, brought to the truth
by the cameras; "position" is the error of the cameras.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from surface_errors import moved

from colmap_ihe.colmap.measures import poses_of
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo import frescoes, materials
from colmap_ihe.evaluation.demo.camera import take_photograph
from colmap_ihe.evaluation.demo.grid import F32, Grid
from colmap_ihe.evaluation.demo.raycast import bake, render
from colmap_ihe.evaluation.demo.scene import Patch
from colmap_ihe.evaluation.demo.shapes import Cylinder, Rect
from colmap_ihe.evaluation.demo.views import arc_of_views
from colmap_ihe.evaluation.truth import TrueImage, Truth, pose_errors
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options_file import load_options

SIZE = (1200, 800)
TEXEL_M = 0.009
NEAR_M = 0.03
RUNS = {
    "COLMAP's default": ("fit.method=rec709", "fit.second=none", "fit.measure=false"),
    "as by default": (),
}


def tiles(grid: Grid) -> F32:
    palette = ((0.70, 0.42, 0.30), (0.30, 0.42, 0.55), (0.80, 0.74, 0.60), (0.40, 0.50, 0.38))
    return materials.masonry(grid, palette, (0.5, 0.48, 0.45), course_m=0.3, length_m=0.3, joint_m=0.01)


def tesserae(grid: Grid, pair: int) -> F32:
    """Lay stones of 4 cm in the two colours of a pair."""

    def pattern(x: F32, y: F32) -> F32:
        stones = np.random.default_rng(pair).standard_normal((64, 64), np.float32)
        rows, columns = (np.floor(24 * v).astype(np.intp) % 64 for v in (y, x))
        return np.asarray(frescoes.scroll(x, y) + 1.2 * stones[rows, columns], np.float32)

    return frescoes.isoluminant(grid, pattern, pair)


def room(wall: materials.Material, floor: materials.Material) -> list[Patch]:
    """Return a wall, the ground before it, and four pillars for depth."""
    patches = [
        Patch(Rect(1, 0.6, (-8, 0), (8, 7.4), -1), wall),
        Patch(Rect(2, 0, (-12, -11), (12, 0.6), 1), floor),
    ]
    for x in (-5.4, -1.8, 1.8, 5.4):
        patches.append(Patch(Cylinder(2, (x, -0.6), 0.3, 0, 5.2), materials.stone))
        patches.append(Patch(Rect(1, -1.0, (x - 0.5, 5.2), (x + 0.5, 5.7), -1), materials.stone))
    return patches


def brick() -> tuple[list[Patch], list[Rect]]:
    patches = room(materials.brick, materials.paving)
    patches += [Patch(Rect(1, 0.5, (x, 2.0), (x + 2.4, 4.4), -1), tiles) for x in (-4.8, -1.2, 2.4)]
    return patches, []


def mosaic() -> tuple[list[Patch], list[Rect]]:
    painted = [Rect(1, 0.55, (x, 1.6), (x + 2.6, 4.8), -1) for x in (-4.9, -1.3, 2.3)]
    patches = room(materials.sound_plaster, materials.paving)
    patches += [Patch(rect, partial(tesserae, pair=pair)) for pair, rect in enumerate(painted)]
    return patches, painted


def ceiling() -> tuple[list[Patch], list[Rect]]:
    """Six panels, three patterns: a coffered frieze above the wall."""
    painted = [Rect(1, 0.45, (x, 4.6), (x + 2.3, 7.1), -1) for x in (-7.2, -4.8, -2.4, 0.1, 2.5, 4.9)]
    pictures = (frescoes.rosette, frescoes.scroll, frescoes.lattice)
    patches = room(materials.rose_plaster, materials.paving)
    patches += [
        Patch(rect, partial(frescoes.isoluminant, pattern=pictures[n % 3], pair=n % 3))
        for n, rect in enumerate(painted)
    ]
    return patches, painted


SETS: Mapping[str, Callable[[], tuple[list[Patch], list[Rect]]]] = {
    "brick": brick,
    "mosaic": mosaic,
    "ceiling": ceiling,
}


def photographs(scene: Sequence[Patch], views: int, folder: Path) -> Truth:
    """Write the JPEGs of a scene, and return where they were taken from."""
    arc = arc_of_views(views, SIZE)
    with ThreadPoolExecutor(local_workers()) as pool:
        surfaces = bake(tuple(scene), TEXEL_M, 0, pool)
        for shot, view in enumerate(arc):
            take_photograph(render(surfaces, view).radiance, view, shot, folder, 0)
    for raw in folder.glob("*.dng"):
        raw.unlink()
    return Truth(
        {v.stem: TrueImage(v.width, v.height, v.calibration, v.cam_from_world) for v in arc}, extent_m=1.0
    )


def row(project: Path, painted: Sequence[Rect], truth: Truth, assignments: Sequence[str]) -> tuple[str, ...]:
    done = reconstruct(project, load_options(None, ["dense.enabled=false", *assignments]))
    s = done.summary
    poses = pose_errors(poses_of(done.sparse_model), truth)
    model = pycolmap.Reconstruction(done.sparse_model)
    points = moved(np.array([p.xyz for p in model.points3D.values()], np.float32), poses.world_from_model)
    of_second = (s["second_grey"] or {}).get("features") or 0
    return (
        f"{s['registered_images']} of {s['images']}",
        f"{s['features']:,} ({of_second:,})",
        f"{s['inlier_matches']:,}",
        f"{s['points3D']:,}",
        f"{sum(on(rect, points) for rect in painted):,}",
        f"{1000 * poses.position_error_percent / 100:.1f}",
        f"{s['mean_reprojection_error_px']:.3f}",
        f"{sum(s['stages'].values()):.0f}",
    )


def on(rect: Rect, points: NDArray[np.float32]) -> int:
    """Count points on a rectangle."""
    near = np.abs(points[:, rect.axis] - rect.at) < NEAR_M
    axes = [axis for axis in range(3) if axis != rect.axis]
    for axis, low, high in zip(axes, rect.low, rect.high, strict=True):
        near &= (points[:, axis] > low) & (points[:, axis] < high)
    return int(near.sum())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=SETS)
    parser.add_argument("--views", type=int, default=8)
    parsed = parser.parse_args()
    rows = []
    for name in parsed.sets:
        with tempfile.TemporaryDirectory() as temporary, quiet():
            root = Path(temporary)
            scene, painted = SETS[name]()
            truth = photographs(scene, parsed.views, root / "images")
            for label, assignments in RUNS.items():
                project = root / label.replace(" ", "-")
                project.mkdir()
                (project / "images").symlink_to(root / "images")
                rows.append((name, label, *row(project, painted, truth, assignments)))
                print(rows[-1], flush=True)
    columns = (
        "registered",
        "features (second)",
        "verified matches",
        "points",
        "on paintings",
        "position, mm",
        "px",
        "s",
    )
    print_table("", rows, ("set", "run", *columns))


if __name__ == "__main__":
    main()
