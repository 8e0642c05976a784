"""Work out sunlight and skylight on the surfaces, once for the whole scene.

Everything is matt and nothing moves, so light does not depend on the camera: it is baked into
the textures. Sunlight has cast shadows; skylight comes from many directions, dimmed by
what stands before them, and the ground and the walls give some of it back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import cv2
import numpy as np

from colmap_ihe.evaluation.demo.grid import F32, F64, Grid
from colmap_ihe.evaluation.demo.scene import Patch
from colmap_ihe.evaluation.demo.shapes import Shape, Vector, corners_of

_TO_SUN = np.array((-0.50, -0.68, 0.62)) / math.sqrt(0.50**2 + 0.68**2 + 0.62**2)
# Nearly neutral light: coloured light would give the isoluminant panels a grey pattern.
_SUN = np.array((1.03, 1.0, 0.94), np.float32) * np.float32(1.15)
_SKY = np.array((0.95, 1.0, 1.07), np.float32) * np.float32(0.50)
_FROM_GROUND = np.array((1.04, 1.0, 0.93), np.float32) * np.float32(0.28)
_FROM_WALLS = np.array((1.03, 1.0, 0.95), np.float32) * np.float32(0.19)

_SUN_GRID_M, _SKY_GRID_M = 0.025, 0.2
_DIRECTIONS = 72
_REACH_M = 9.0  # what is farther away does not dim skylight


def sunlight(scene: Sequence[Patch], grids: Sequence[Grid], executor: Executor) -> list[F32]:
    """Return for each patch (h, w) on a grid of its own: cosine of the sun's incidence, 0 in cast shadow."""
    bounds = np.stack([_seen_from_sun(patch.shape) for patch in scene])
    towards = list(_TO_SUN.astype(np.float32))

    def on_patch(patch: Patch, grid: Grid, reach: F64) -> F32:
        lattice = replace(grid, texel_m=max(_SUN_GRID_M, grid.texel_m))
        point, normal = patch.shape.surface(lattice.across, lattice.down)
        cosine = np.maximum(_dot(normal, towards), np.float32(0))
        if not np.any(cosine > 0):
            return cosine
        origin = _lifted(point, normal)
        lit = np.ones(cosine.shape, bool)
        beside = (bounds[:, 0, :2] > reach[1, :2]) | (bounds[:, 1, :2] < reach[0, :2])
        behind = bounds[:, 1, 2] < reach[0, 2]
        for k in np.flatnonzero(~(beside.any(axis=1) | behind)):
            lit &= ~np.isfinite(scene[int(k)].shape.hit(origin, towards))
        soft = cv2.GaussianBlur(lit.astype(np.float32), (0, 0), max(0.3, 0.03 / lattice.texel_m))
        return np.asarray(cosine * soft, np.float32)

    return list(executor.map(on_patch, scene, grids, bounds))


def skylight(scene: Sequence[Patch], grids: Sequence[Grid], executor: Executor) -> list[F32]:
    """Return for each patch (h, w, 3) on a coarse grid of its own: light from sky, ground, walls; linear RGB."""
    lattices = [replace(grid, texel_m=_SKY_GRID_M) for grid in grids]
    surfaces = [p.shape.surface(g.across, g.down) for p, g in zip(scene, lattices, strict=True)]
    point, normal = ([np.concatenate([s[i][k].ravel() for s in surfaces]) for k in range(3)] for i in (0, 1))
    # Small things dim the sky little, and there are many of them.
    large = [patch.shape for patch in scene if math.prod(patch.shape.size_m) > 1.2]

    def from_direction(direction: F64) -> tuple[F32, F32]:
        towards = list(direction.astype(np.float32))
        cosine = _dot(normal, towards)
        facing = np.flatnonzero(cosine > 0)
        origin = _lifted([p[facing] for p in point], [n[facing] for n in normal])
        clear = np.ones(facing.size, bool)
        for shape in large:
            clear &= ~(shape.hit(origin, towards) < _REACH_M)
        beyond = _SKY * np.float32(0.8 + 0.4 * direction[2]) if direction[2] > 0 else _FROM_GROUND
        light = np.zeros((cosine.size, 3), np.float32)
        light[facing] = cosine[facing, None] * np.where(clear[:, None], beyond, _FROM_WALLS)
        return light, np.maximum(cosine, np.float32(0))

    total, weight = np.zeros((point[0].size, 3), np.float32), np.zeros(point[0].size, np.float32)
    for light, cosine in executor.map(from_direction, _sphere()):
        total += light
        weight += cosine
    mean = total / np.maximum(weight, np.float32(1e-6))[:, None]
    ends = np.cumsum([math.prod(g.shape) for g in lattices])
    parts = np.split(np.asarray(mean, np.float32), ends[:-1])
    return [p.reshape((*g.shape, 3)) for p, g in zip(parts, lattices, strict=True)]


def irradiance(sun: F32, sky: F32, shape: tuple[int, int]) -> F32:
    """Return (H, W, 3) of a (h, w) `sun` and a (h, w, 3) `sky`; at 1 a white surface has radiance 1."""
    direct, diffuse = (np.asarray(cv2.resize(light, shape[::-1]), np.float32) for light in (sun, sky))
    return direct[..., None] * _SUN + diffuse


def _lifted(point: Vector, normal: Vector) -> Vector:
    """Return points 4 mm off the surface, so that it does not shade itself."""
    return [p + np.float32(0.004) * n for p, n in zip(point, normal, strict=True)]


def _dot(first: Vector, second: Vector) -> F32:
    return np.asarray(first[0] * second[0] + first[1] * second[1] + first[2] * second[2], np.float32)


def _seen_from_sun(shape: Shape) -> F64:
    """Return (2, 3): bounds of a shape's box across the sunlight (two axes) and towards the sun."""
    side = np.cross(_TO_SUN, (0, 0, 1))
    side /= np.linalg.norm(side)
    axes = np.stack((side, np.cross(side, _TO_SUN), _TO_SUN))
    corners = corners_of(shape) @ axes.T
    return np.stack((corners.min(axis=0), corners.max(axis=0)))


def _sphere() -> F64:
    """Return (_DIRECTIONS, 3): unit vectors evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(_DIRECTIONS)
    z = 1 - (2 * k + 1) / _DIRECTIONS
    angle = k * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - z * z)
    return np.stack((ring * np.cos(angle), ring * np.sin(angle), z), axis=1)
