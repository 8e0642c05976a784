"""Hold the lines of drawings in layers, and cut a mesh into them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float64, Int64, UInt8
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.frames import PlaneFrame


@dataclass(frozen=True)
class Line:
    """Hold a line through `points` (N, 2), across and up on a drawing; `closed` if it ends where it begins."""

    points: Float64
    closed: bool = False


@dataclass(frozen=True)
class Layer:
    """Hold the lines of one layer: its name, as in a DXF file, a colour (0-255 each), and the width in millimetres of
    paper."""

    name: str
    lines: list[Line]
    colour: tuple[int, int, int] = (0, 0, 0)
    width_mm: float = 0.18


def section(mesh: Mesh, frame: PlaneFrame) -> list[Line]:
    """Return where a mesh meets the plane of a drawing. A vertex on the plane counts as in front of it, so that no line
    runs through a vertex twice."""
    places = frame.to_drawing(mesh.vertices.astype(np.float64))
    front = places[:, 2] >= 0
    side = front[mesh.faces]
    cut = np.flatnonzero(side.any(axis=1) & ~side.all(axis=1))
    faces, side = mesh.faces[cut].astype(np.int64), side[cut]
    alone = np.where(side.sum(axis=1) == 1, side.argmax(axis=1), (~side).argmax(axis=1))
    rows = np.arange(len(faces))
    tip, after, last = (faces[rows, (alone + k) % 3] for k in range(3))
    ends = np.stack((_edges(tip, after), _edges(tip, last)), axis=1)
    keys, numbers = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    a, b = places[keys[:, 0]], places[keys[:, 1]]
    share = (a[:, 2] / (a[:, 2] - b[:, 2]))[:, None]
    points = (a + share * (b - a))[:, :2]
    return _chained(points, numbers.reshape(-1, 2))


def _edges(first: Int64, second: Int64) -> Int64:
    return np.stack((np.minimum(first, second), np.maximum(first, second)), axis=1)


def _chained(points: Float64, pairs: Int64) -> list[Line]:
    """Return lines through points (N, 2) that pairs (E, 2) join: each from an end where there is one, else around."""
    beside: dict[int, list[int]] = defaultdict(list)
    for first, second in pairs.tolist():
        beside[first].append(second)
        beside[second].append(first)
    ends = [point for point, others in beside.items() if len(others) == 1]
    lines = []
    for start in [*ends, *list(beside)]:
        while beside[start]:
            chain = _followed(start, beside)
            closed = len(chain) > 3 and chain[0] == chain[-1]
            lines.append(Line(points[chain[:-1] if closed else chain], closed))
    return lines


def _followed(start: int, beside: dict[int, list[int]]) -> list[int]:
    chain = [start]
    while beside[chain[-1]]:
        here = chain[-1]
        following = beside[here].pop()
        beside[following].remove(here)
        chain.append(following)
        if following == start:
            break
    return chain


def length_of(lines: list[Line]) -> float:
    """Return how long lines are in all."""
    total = 0.0
    for line in lines:
        points = np.concatenate((line.points, line.points[:1])) if line.closed else line.points
        total += float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return total


def bounds_of(lines: list[Line]) -> tuple[float, float, float, float]:
    """Return left, bottom, right and top of lines. Raises ValueError for none."""
    if not lines:
        raise ValueError("no lines")
    points = np.concatenate([line.points for line in lines])
    left, bottom = points.min(axis=0).tolist()
    right, top = points.max(axis=0).tolist()
    return left, bottom, right, top


def lines_drawn(lines: list[Line], longest: int) -> UInt8:
    """Return (H, W, 3) uint8: black lines on white, the longer side `longest` pixels."""
    left, bottom, right, top = bounds_of(lines)
    scale = 0.94 * longest / max(right - left, top - bottom, 1e-9)
    margin = 0.03 * longest
    width, height = (round(scale * n + 2 * margin) for n in (right - left, top - bottom))
    picture = np.full((height, width, 3), 255, np.uint8)
    for line in lines:
        pixels = (line.points - (left, top)) * (scale, -scale) + margin
        fine = np.rint(8 * pixels).astype(np.int32)[:, None]
        cv2.polylines(picture, [fine], line.closed, (0, 0, 0), 2, cv2.LINE_AA, 3)
    return picture
