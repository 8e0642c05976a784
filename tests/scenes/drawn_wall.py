"""A wall that stands askew, with a niche and a known picture on it, and cameras that see it; and a house."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from colmap_ihe.dense.camera import Float64, PinholeCamera, UInt8
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.colours import Photograph
from colmap_ihe.drawings.painted import Source

UP = np.array((0.0, 0.0, 1.0))
TURN = np.radians(20)
"""Of the wall about the vertical, from the plane y = 0."""
RIGHT = np.array((np.cos(TURN), np.sin(TURN), 0.0))
NORMAL = np.array((np.sin(TURN), -np.cos(TURN), 0.0))
FOOT = np.array((3.0, 5.0, 0.0))
"""A point on the wall, at height zero: the lower left corner."""
WIDTH, HEIGHT, NICHE = 4.0, 3.0, 0.25
"""Metres; the niche from 1.5 to 2.5 across and from 1 to 2 up, so deep."""
CELL = 0.05


def on_wall(across: npt.NDArray[np.floating], up: npt.NDArray[np.floating], out: float = 0.0) -> Float64:
    """Return (..., 3), points of the world at places of the wall."""
    return np.asarray(
        FOOT + np.asarray(across)[..., None] * RIGHT + np.asarray(up)[..., None] * UP + out * NORMAL
    )


def in_niche(across: npt.NDArray[np.floating], up: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Return true where the wall is set back."""
    return np.asarray((across > 1.5) & (across < 2.5) & (up > 1) & (up < 2))


def wall_mesh() -> Mesh:
    """Return the wall, its niche `NICHE` behind it, without sides."""
    columns, rows = round(WIDTH / CELL), round(HEIGHT / CELL)
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    back = in_niche((column + 0.5) * CELL, (row + 0.5) * CELL)
    corners = []
    for chosen, out in ((~back, 0.0), (back, -NICHE)):
        c, r = column[chosen], row[chosen]
        a, b, d, e = (
            on_wall(CELL * (c + i), CELL * (r + j), out) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
        )
        corners += [np.stack((a, b, d), axis=1), np.stack((a, d, e), axis=1)]
    every = np.concatenate(corners).reshape(-1, 3)
    vertices, faces = np.unique(every.round(6), axis=0, return_inverse=True)
    grey = np.full((len(vertices), 3), 90, np.uint8)
    return Mesh(vertices.astype(np.float32), faces.reshape(-1, 3).astype(np.int32), grey)


def colour_at(across: npt.NDArray[np.floating], up: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Return (..., 3), the picture on the wall: smooth waves, so that a place is told by its colour."""
    red = 128 + 100 * np.sin(2 * np.pi * across / 1.7)
    green = 128 + 100 * np.cos(2 * np.pi * up / 1.3)
    blue = 128 + 100 * np.sin(2 * np.pi * (across + up) / 2.3)
    return np.stack((red, green, blue), axis=-1)


def camera_at(across: float, distance: float = 5.0) -> PinholeCamera:
    """Return a camera that looks straight at the wall, its middle at half its height."""
    rotation = np.stack((RIGHT, -UP, -NORMAL))
    centre = on_wall(np.array(across), np.array(HEIGHT / 2), distance)
    pose = np.column_stack((rotation, -rotation @ centre))
    return PinholeCamera(np.array(((500, 0, 320), (0, 500, 240), (0, 0, 1.0))), pose, (640, 480))


def picture_of(camera: PinholeCamera) -> UInt8:
    """Return (H, W, 3) uint8, what a camera of `camera_at` sees."""
    width, height = camera.size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ray = np.stack(((x - 320) / 500, (y - 240) / 500, np.ones_like(x)), axis=-1) @ camera.rotation
    centre = (camera.centre - FOOT) @ NORMAL
    places = []
    for out in (0.0, -NICHE):
        t = (out - centre) / (ray @ NORMAL)
        point = camera.centre - FOOT + t[..., None] * ray
        places.append((point @ RIGHT, point @ UP))
    (a, u), (deep_a, deep_u) = places
    back = in_niche(a, u)
    return np.asarray(np.rint(colour_at(np.where(back, deep_a, a), np.where(back, deep_u, u))), np.uint8)


def wall_photographs() -> tuple[list[Source], list[Photograph]]:
    """Return three photographs of the wall, as they are chosen from and as colours are taken."""
    sources, photographs = [], []
    for number, across in enumerate((1.0, 2.0, 3.0)):
        camera = camera_at(across)
        read = partial(picture_of, camera)
        sources.append(Source(camera, read, lambda: None))
        photographs.append(Photograph(f"{number}.png", read, camera.project, 500.0))  # type: ignore[arg-type]
    return sources, photographs


def box(size: tuple[float, float, float], steps: int = 12) -> Mesh:
    """Return the four walls of a house and its flat roof, in many faces."""
    corners = []
    for axis, side in ((0, -1), (0, 1), (1, -1), (1, 1), (2, 1)):
        others = [k for k in range(3) if k != axis]
        grid = np.stack(np.meshgrid(*[np.linspace(0, 1, steps + 1)] * 2, indexing="ij"), axis=-1)
        place = np.zeros((*grid.shape[:2], 3))
        place[..., others] = grid * np.array(size)[others]
        place[..., axis] = size[axis] if side > 0 else 0
        a, b, c, d = place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]
        faces = np.concatenate(
            (np.stack((a, b, c), -2).reshape(-1, 3, 3), np.stack((a, c, d), -2).reshape(-1, 3, 3))
        )
        normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])[:, axis]
        corners.append(np.where((normal * side > 0)[:, None, None], faces, faces[:, ::-1]))
    vertices = np.concatenate(corners).reshape(-1, 3).astype(np.float32)
    rows = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    return Mesh(vertices, rows, np.zeros((len(vertices), 3), np.uint8))
