"""Measure drawings of the demo against its true geometry.

    python benchmarks/drawings.py PROJECT [--pixel 0.005] [--large] [--json]

PROJECT: the demo, reconstructed with its control. Its front is drawn twice: from the true surfaces and cameras, which
tells what drawing itself loses, and from the mesh that was reconstructed. Beside the true view from infinitely far:
positions (patches of 96 pixels that are moved to where they agree), relief, colours after one gain for each channel,
and a section through the middle. `--large`: processor time and memory of 50 megapixels, by the command.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, PinholeCamera, UInt8
from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.dense.undistort import read_colour
from colmap_ihe.drawings.colours import Band, PaintedSurface, Photograph, paint
from colmap_ihe.drawings.frames import PlaneFrame, plane_frame
from colmap_ihe.drawings.grid import PixelGrid
from colmap_ihe.drawings.lines import Line, section
from colmap_ihe.drawings.painted import Source, paint_mesh, painted_surface
from colmap_ihe.drawings.surface import drawn_faces, seen_surface
from colmap_ihe.evaluation.demo import raycast
from colmap_ihe.evaluation.demo.scene import portico
from colmap_ihe.evaluation.demo.shapes import Cylinder, Rect, Shape, Sphere
from colmap_ihe.evaluation.demo.targets import target_patches
from colmap_ihe.grey.srgb import coded
from colmap_ihe.machine.executor import local_executor

_CELL, _FINER, _SAG = (
    0.08,
    8,
    0.0002,
)  # metres of a face of the true mesh, finer at holes; off a curve at most
_PATCH, _STEP = 96, 0.05  # pixels; metres of depth between neighbours at an edge
_UP = np.array((0.0, 0.0, 1.0))
_BEHIND, _BEFORE = 4.5, 3.5
FRONT = plane_frame(np.zeros(3), np.array((0.0, -1.0, 0.0)), _UP)
_LEFT, _TOP, _WIDTH, _HEIGHT = (
    -6.0,
    7.2,
    12.0,
    6.7,
)  # metres: the middle of the front, which all photographs show
Row = dict[str, Any]


def shapes() -> list[Shape]:
    return [patch.shape for patch in (*portico(), *target_patches())]


def true_mesh() -> Mesh:
    """Return the surfaces of the demo as triangles, for what can be seen from the front."""
    parts = [_faces_of(shape) for shape in shapes() if float(shape.box[1, 1]) > -4]
    corners = np.concatenate(parts)
    faces = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    vertices = corners.reshape(-1, 3)
    unique, rows = np.unique(np.round(vertices, 5), axis=0, return_inverse=True)
    grey = np.full((len(unique), 3), 128, np.uint8)
    return Mesh(unique.astype(np.float32), rows.reshape(-1)[faces].astype(np.int32), grey)


def _faces_of(shape: Shape) -> Float64:
    """Return (F, 3, 3), the corners of triangles on a shape, anticlockwise from where it is seen."""
    width, height = shape.size_m
    steps = [_CELL, _CELL]
    if not isinstance(shape, Rect):
        fine = float(np.sqrt(8 * shape.radius * _SAG))
        steps = [min(fine, _CELL), _CELL if isinstance(shape, Cylinder) else min(fine, _CELL)]
    across = np.linspace(0, width, max(1, round(width / steps[0])) + 1)
    down = np.linspace(0, height, max(1, round(height / steps[1])) + 1)
    whole, mixed = _cells(shape, across, down)
    quads = [_quads(shape, across, down, whole)]
    for row, column in np.argwhere(mixed):
        a = np.linspace(across[column], across[column + 1], _FINER + 1)
        d = np.linspace(down[row], down[row + 1], _FINER + 1)
        quads.append(_quads(shape, a, d, _covered(shape, (a[1:] + a[:-1]) / 2, (d[1:] + d[:-1]) / 2)))
    return np.concatenate(quads)


def _covered(shape: Shape, across: Float64, down: Float64) -> Bool:
    if not isinstance(shape, Rect):
        return np.ones((len(down), len(across)), bool)
    first = (shape.low[0] + across)[None].astype(np.float32)
    second = (shape.high[1] - down)[:, None].astype(np.float32)
    covers = np.ones((len(down), len(across)), bool)
    for hole in shape.holes:
        covers &= ~hole.contains(first, second)
    if shape.disc:
        aside, along = (
            first - sum((shape.low[0], shape.high[0])) / 2,
            second - sum((shape.low[1], shape.high[1])) / 2,
        )
        covers &= aside**2 + along**2 <= (shape.size_m[0] / 2) ** 2
    return covers


def _cells(shape: Shape, across: Float64, down: Float64) -> tuple[Bool, Bool]:
    nodes = _covered(shape, across, down)
    count = nodes[1:, 1:].astype(int) + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[:-1, :-1]
    return count == 4, (count > 0) & (count < 4)


def _quads(shape: Shape, across: Float64, down: Float64, kept: Bool) -> Float64:
    point, normal = shape.surface(across[None].astype(np.float32), down[:, None].astype(np.float32))
    places = np.stack([np.broadcast_to(p, (len(down), len(across))) for p in point], axis=-1).astype(
        np.float64
    )
    outward = np.stack([np.broadcast_to(n, (len(down), len(across))) for n in normal], axis=-1)
    row, column = np.nonzero(kept)
    a, b = places[row, column], places[row, column + 1]
    c, d = places[row + 1, column + 1], places[row + 1, column]
    triangles = np.concatenate((np.stack((a, d, c), axis=1), np.stack((a, c, b), axis=1)))
    direction = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    turned = (direction * np.tile(outward[row, column], (2, 1))).sum(axis=1) < 0
    triangles[turned] = triangles[turned][:, ::-1]
    return np.asarray(triangles[np.linalg.norm(direction, axis=1) > 1e-12])


def true_view(grid: PixelGrid, executor: Executor) -> tuple[Float32, Float32]:
    """Return (H, W) metres out of the plane y = 0, and (H, W, 3) linear radiance, of 2 x 2 rays a pixel."""
    surfaces = raycast.bake((*portico(), *target_patches()), 0.0075, 0, executor)
    out, _, _ = _cast(surfaces, grid)
    fine = PixelGrid(grid.left, grid.top, grid.pixel / 2, 2 * grid.width, 2 * grid.height)
    radiance = np.zeros((fine.height, fine.width, 3), np.float32)
    for row, part in fine.bands(2_000_000):
        nearest, index, origin = _cast(surfaces, part)
        for k in np.unique(index[index >= 0]):
            hit = index == k
            point = [o[hit] for o in origin]
            point[1] = -nearest[hit]
            across, down = surfaces[k].shape.locate(point)
            footprint = np.full(hit.sum(), fine.pixel, np.float32)
            sampled = raycast._sample(surfaces[k], across, down, footprint)
            radiance[row : row + part.height][hit] = sampled
    return out, np.asarray(cv2.resize(radiance, (grid.width, grid.height), interpolation=cv2.INTER_AREA))


def _cast(surfaces: list[raycast.Surface], grid: PixelGrid) -> tuple[Float32, Any, list[Float32]]:
    """Return how far out each pixel's surface is, its number, and where the rays begin, along y."""
    across, up = grid.across().astype(np.float32), grid.up().astype(np.float32)
    x, z = np.meshgrid(across, up)
    start = np.float32(-_BEFORE)
    nearest, index = np.full(x.shape, np.inf, np.float32), np.full(x.shape, -1, np.int16)
    for k, surface in enumerate(surfaces):
        if isinstance(surface.shape, Rect) and (surface.shape.axis != 1 or surface.shape.side > 0):
            continue
        low, high = surface.shape.box
        columns = slice(*np.searchsorted(across, (low[0], high[0])))
        rows = slice(*np.searchsorted(-up, (-high[2], -low[2])))
        if columns.start >= columns.stop or rows.start >= rows.stop:
            continue
        part = np.s_[rows, columns]
        zero, one = np.zeros(1, np.float32), np.ones(1, np.float32)
        t = surface.shape.hit([x[part], np.full_like(x[part], start), z[part]], [zero, one, zero])
        closer = t < nearest[part]
        nearest[part][closer], index[part][closer] = t[closer], k
    out = -(start + nearest)
    return np.where(np.isfinite(nearest), out, np.nan).astype(np.float32), index, [x, np.zeros_like(x), z]


def front(mesh: Mesh, surface: PaintedSurface, grid: PixelGrid) -> Band:
    faces = drawn_faces(mesh, FRONT, _BEHIND, _BEFORE)
    seen = seen_surface(faces, grid, _BEHIND, _BEFORE)
    return paint(surface, faces, seen, FRONT, grid)


def compared(name: str, band: Band, out: Float32, radiance: Float32) -> Row:
    known = ~np.isnan(band.out) & ~np.isnan(out)
    off = 1000 * np.abs(band.out - out)
    away = known & ~_near_edges(out)
    true, fitted = _in_levels(band, radiance, away & (off < 20) & band.by_photograph)
    colour = np.abs(fitted - true).max(axis=2)[away & (off < 20) & band.by_photograph]
    shifts = _shifts(band.rgb, true, known & (off < 50))
    return {
        "set": name,
        "covered_percent": 100 * known.sum() / (~np.isnan(out)).sum(),
        "relief_median_mm": float(np.median(off[known])),
        "relief_95_mm": float(np.percentile(off[known], 95)),
        "relief_95_away_from_edges_mm": float(np.percentile(off[away], 95)),
        "position_rms_px": float(np.sqrt(np.mean(shifts**2))) if len(shifts) else np.nan,
        "patches": len(shifts),
        "colour_median_levels": float(np.median(colour)),
        "colour_mean_levels": float(np.mean(colour)),
        "colour_95_levels": float(np.percentile(colour, 95)),
    }


def _near_edges(out: Float32) -> Bool:
    filled = np.nan_to_num(out, nan=-99)
    kernel = np.ones((7, 7), np.uint8)
    step = cv2.dilate(filled, kernel) - cv2.erode(filled, kernel)
    return np.asarray(step > _STEP)


def _in_levels(band: Band, radiance: Float32, chosen: Bool) -> tuple[Float32, Float32]:
    """Return the true view and the drawing in levels, the true one with the gain for each channel that fits best."""
    best = []
    for k in range(3):
        drawn = band.rgb[..., k][chosen][::7].astype(np.float32)
        truth = radiance[..., k][chosen][::7]
        gains = np.geomspace(0.2, 3, 120)
        errors = [
            np.median(np.abs(255 * coded(np.clip(g * truth, 0, 1).astype(np.float32)) - drawn)) for g in gains
        ]
        best.append(gains[int(np.argmin(errors))])
    true = 255 * coded(np.clip(radiance * np.array(best, np.float32), 0, 1).astype(np.float32))
    return np.asarray(true, np.float32), band.rgb.astype(np.float32)


def _shifts(drawn: UInt8, true: Float32, known: Bool) -> Float64:
    """Return (N,), by how many pixels patches of a drawing are off."""
    first = cv2.cvtColor(drawn, cv2.COLOR_RGB2GRAY).astype(np.float32)
    second = cv2.cvtColor(np.clip(true, 0, 255).astype(np.uint8), cv2.COLOR_RGB2GRAY).astype(np.float32)
    window = cv2.createHanningWindow((_PATCH, _PATCH), cv2.CV_32F)
    found = []
    for top in range(0, first.shape[0] - _PATCH, _PATCH // 2):
        for left in range(0, first.shape[1] - _PATCH, _PATCH // 2):
            part = np.s_[top : top + _PATCH, left : left + _PATCH]
            if known[part].mean() < 0.98 or second[part].std() < 6:
                continue
            shift, response = cv2.phaseCorrelate(first[part], second[part], window)
            if response > 0.3:
                found.append(float(np.hypot(shift[0], shift[1])))
    return np.array(found)


def section_errors(mesh: Mesh, frame: PlaneFrame) -> Float64:
    """Return (N,), how far points along a section are from the true surfaces, in millimetres."""
    points = np.concatenate([_along(line) for line in section(mesh, frame)])
    places = frame.to_model(np.column_stack((points, np.zeros(len(points)))))
    return np.asarray(1000 * np.min([_distance(shape, places) for shape in shapes()], axis=0))


def _along(line: Line) -> Float64:
    """Return (N, 2), points every centimetre along a line."""
    ends = np.concatenate((line.points, line.points[:1])) if line.closed else line.points
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))))
    at = np.arange(0, length[-1], 0.01)
    return np.stack([np.interp(at, length, ends[:, k]) for k in range(2)], axis=1)


def _distance(shape: Shape, points: Float64) -> Float64:
    """Return (N,), how far points (N, 3) are from a shape; from a hole in it far."""
    if isinstance(shape, Sphere):
        return np.asarray(np.abs(np.linalg.norm(points - shape.centre, axis=1) - shape.radius))
    others = [k for k in range(3) if k != shape.axis]
    if isinstance(shape, Cylinder):
        apart = points[:, others] - shape.centre
        beyond = np.maximum(
            0, np.maximum(shape.low - points[:, shape.axis], points[:, shape.axis] - shape.high)
        )
        off = np.hypot(np.linalg.norm(apart, axis=1) - shape.radius, beyond)
        return np.where(apart[:, 1] < 0, np.inf, off) if shape.vault else off
    nearest = np.clip(points[:, others], shape.low, shape.high)
    off = np.hypot(np.linalg.norm(points[:, others] - nearest, axis=1), points[:, shape.axis] - shape.at)
    inside = np.zeros(len(points), bool)
    for hole in shape.holes:
        inside |= hole.contains(nearest[:, 0].astype(np.float32), nearest[:, 1].astype(np.float32))
    return np.where(inside, np.inf, off)


def true_sources(project: Path) -> tuple[list[Source], list[Photograph]]:
    """Return the photographs of the demo with their true cameras."""
    sources, photographs = [], []
    cameras = json.loads((project / "truth/cameras.json").read_text())["cameras"]
    for stem, values in sorted(cameras.items()):
        camera = PinholeCamera(
            np.array(values["calibration"]),
            np.array(values["cam_from_world"]),
            (values["width"], values["height"]),
        )
        read = partial(read_colour, project / f"colour/{stem}.png")
        sources.append(Source(camera, read, lambda: None))
        photographs.append(Photograph(stem, read, camera.project, float(camera.K[0, 0])))  # type: ignore[arg-type]
    return sources, photographs


def large(project: Path) -> Row:
    """Return processor minutes and memory of 50 megapixels of the front, with all that comes with it."""
    about = json.loads((project / "drawings/front/drawing.json").read_text())
    pixel = about["pixel_mm"] * (about["width"] * about["height"] / 50e6) ** 0.5
    command = [sys.executable, "-m", "colmap_ihe", "draw", str(project), "--view", "front", "-q"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([*command, "--mm-per-pixel", f"{pixel:.4f}"], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"set": "50 megapixels", "core_minutes": seconds / 60, "memory_gb": after.ru_maxrss / 1e6}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("project", type=Path)
    parser.add_argument("--pixel", type=float, default=0.005)
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--only", choices=("true", "made"))
    parser.add_argument("--pictures", type=Path, help="a folder for what was drawn and what is true")
    parser.add_argument("--json", action="store_true")
    parsed = parser.parse_args()
    rows: list[Row] = [large(parsed.project)] if parsed.large else measured(parsed)
    for row in rows:
        values = "  ".join(f"{k} {v:.4g}" for k, v in row.items() if k != "set")
        print(json.dumps(row) if parsed.json else f"{row['set']:24} {values}")


def measured(parsed: argparse.Namespace) -> list[Row]:
    grid = PixelGrid(_LEFT, _TOP, parsed.pixel, round(_WIDTH / parsed.pixel), round(_HEIGHT / parsed.pixel))
    dense = parsed.project / "workspace/dense/0"
    middle = plane_frame(np.array((0.35, 0.0, 0.0)), np.array((1.0, 0.0, 0.0)), _UP)
    rows = []
    with local_executor() as executor:
        out, radiance = true_view(grid, executor)
        if parsed.only != "made":
            mesh = true_mesh()
            surface = paint_mesh(mesh, *true_sources(parsed.project), executor)
            rows.append(_row("true surfaces", mesh, surface, grid, out, radiance, middle, parsed.pictures))
        if parsed.only != "true":
            mesh = read_mesh(dense / "mesh.ply")
            metric, colour = parsed.project / "workspace/metric", parsed.project / "colour"
            surface = painted_surface(mesh, dense, metric, colour, executor)
            rows.append(_row("reconstructed", mesh, surface, grid, out, radiance, middle, parsed.pictures))
    return rows


def _row(
    name: str,
    mesh: Mesh,
    surface: PaintedSurface,
    grid: PixelGrid,
    out: Float32,
    radiance: Float32,
    middle: PlaneFrame,
    pictures: Path | None,
) -> Row:
    band = front(mesh, surface, grid)
    row = compared(name, band, out, radiance)
    errors = section_errors(mesh, middle)
    if pictures:
        np.savez(pictures / f"{name}.npz", rgb=band.rgb, out=band.out, true=out, radiance=radiance)
    return {
        **row,
        "section_median_mm": float(np.median(errors)),
        "section_95_mm": float(np.percentile(errors, 95)),
    }


if __name__ == "__main__":
    main()
