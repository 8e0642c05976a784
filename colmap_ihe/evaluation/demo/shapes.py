"""Intersect rays with the shapes of the scene: rectangles with openings, cylinders, spheres.

The world is in metres: x to the right along the facade, y into it, z up. Rectangles are
perpendicular to an axis and cylinders lie along one, so a ray meets them in a few operations.
Rays are three arrays that broadcast: `origin + t * direction`. Every shape has

    size_m      (width, height) of its texture; `across` and `down` are metres from its upper left corner
    box         (2, 3) float64: lower and upper corner of its bounding box
    faces       whether its textured side may be seen from a point (3,)
    hit         the least t > 0 at which each ray meets it, inf where it does not
    locate      (across, down) of points on it
    surface     points on it and the unit normals of its textured side there
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from colmap_ihe.evaluation.demo.grid import F32, F64

Vector = Sequence[F32]
"""x, y and z, three arrays."""

_OTHERS = ((1, 2), (0, 2), (0, 1))
_NEAREST_M = np.float32(2e-3)  # a ray that leaves a surface does not meet it again at once


@dataclass(frozen=True)
class Arch:
    """Describe an opening in a rectangle: `half` to each side of `centre`, up to `spring`, and a half circle on it."""

    centre: float
    spring: float
    half: float

    def contains(self, first: F32, second: F32) -> npt.NDArray[np.bool_]:
        aside = first - np.float32(self.centre)
        above = np.maximum(second - np.float32(self.spring), 0)
        return np.asarray(aside * aside + above * above < np.float32(self.half**2))


@dataclass(frozen=True)
class Rect:
    """Describe a rectangle perpendicular to `axis` at `at`, seen from its `side` (+1 or -1).

    `low` and `high` are its corners on the other two axes, in order; `holes` are open; a `disc`
    is only its inscribed circle.
    """

    axis: int
    at: float
    low: tuple[float, float]
    high: tuple[float, float]
    side: int
    holes: tuple[Arch, ...] = ()
    disc: bool = False

    @property
    def size_m(self) -> tuple[float, float]:
        return self.high[0] - self.low[0], self.high[1] - self.low[1]

    @property
    def box(self) -> F64:
        box = np.empty((2, 3))
        box[:, self.axis] = self.at
        box[:, _OTHERS[self.axis]] = self.low, self.high
        return box

    def faces(self, point: F64) -> bool:
        return bool((point[self.axis] - self.at) * self.side > 0)

    def hit(self, origin: Vector, direction: Vector) -> F32:
        i, j = _OTHERS[self.axis]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            t = (np.float32(self.at) - origin[self.axis]) / direction[self.axis]
            first = origin[i] + t * direction[i]
            second = origin[j] + t * direction[j]
            inside = (t > _NEAREST_M) & self._covers(first, second)
        return np.where(inside, t, np.float32(np.inf))

    def _covers(self, first: F32, second: F32) -> npt.NDArray[np.bool_]:
        if self.disc:
            aside = first - np.float32((self.low[0] + self.high[0]) / 2)
            along = second - np.float32((self.low[1] + self.high[1]) / 2)
            return np.asarray(aside * aside + along * along <= np.float32((self.size_m[0] / 2) ** 2))
        covers = (first >= self.low[0]) & (first <= self.high[0])
        covers &= (second >= self.low[1]) & (second <= self.high[1])
        for hole in self.holes:
            covers &= ~hole.contains(first, second)
        return np.asarray(covers)

    def locate(self, point: Vector) -> tuple[F32, F32]:
        i, j = _OTHERS[self.axis]
        return point[i] - np.float32(self.low[0]), np.float32(self.high[1]) - point[j]

    def surface(self, across: F32, down: F32) -> tuple[Vector, Vector]:
        i, j = _OTHERS[self.axis]
        zero = np.zeros(np.broadcast_shapes(across.shape, down.shape), np.float32)
        point, normal = [zero + np.float32(self.at)] * 3, [zero] * 3
        point[i] = zero + across + np.float32(self.low[0])
        point[j] = zero + np.float32(self.high[1]) - down
        normal[self.axis] = zero + np.float32(self.side)
        return point, normal


@dataclass(frozen=True)
class Cylinder:
    """Describe a cylinder along `axis` from `low` to `high`; `centre` is on the other two axes, in order.

    A column is a whole cylinder seen from outside. With `vault` it is the half towards +z, seen
    from inside: a barrel vault or the underside of an arch.
    """

    axis: int
    centre: tuple[float, float]
    radius: float
    low: float
    high: float
    vault: bool = False

    @property
    def size_m(self) -> tuple[float, float]:
        return (1 if self.vault else 2) * math.pi * self.radius, self.high - self.low

    @property
    def box(self) -> F64:
        box = np.empty((2, 3))
        box[:, self.axis] = self.low, self.high
        for axis, middle in zip(_OTHERS[self.axis], self.centre, strict=True):
            box[:, axis] = middle - self.radius, middle + self.radius
        if self.vault:
            box[0, 2] = self.centre[1]
        return box

    def faces(self, point: F64) -> bool:
        return True

    def hit(self, origin: Vector, direction: Vector) -> F32:
        i, j = _OTHERS[self.axis]
        first, second = origin[i] - np.float32(self.centre[0]), origin[j] - np.float32(self.centre[1])
        a = direction[i] * direction[i] + direction[j] * direction[j]
        b = first * direction[i] + second * direction[j]
        c = first * first + second * second - np.float32(self.radius**2)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            root = np.sqrt(b * b - a * c)  # nan where the ray passes by: every comparison below is then false
            t = (-b + root) / a if self.vault else (-b - root) / a
            along = origin[self.axis] + t * direction[self.axis]
            inside = (t > _NEAREST_M) & (along >= self.low) & (along <= self.high)
            if self.vault:
                inside &= second + t * direction[j] >= 0
        return np.where(inside, t, np.float32(np.inf))

    def locate(self, point: Vector) -> tuple[F32, F32]:
        i, j = _OTHERS[self.axis]
        first, second = point[i] - np.float32(self.centre[0]), point[j] - np.float32(self.centre[1])
        # The seam of a column is at its back, the middle of a vault's texture at its crown.
        angle = np.arctan2(first, second if self.vault else -second)
        across = angle * np.float32(self.radius) + np.float32(self.size_m[0] / 2)
        return across, np.float32(self.high) - point[self.axis]

    def surface(self, across: F32, down: F32) -> tuple[Vector, Vector]:
        i, j = _OTHERS[self.axis]
        zero = np.zeros(np.broadcast_shapes(across.shape, down.shape), np.float32)
        angle = (across - np.float32(self.size_m[0] / 2)) / np.float32(self.radius) + zero
        first, second = np.sin(angle), np.cos(angle) * (1 if self.vault else -1)
        point, normal = [zero] * 3, [zero] * 3
        point[self.axis] = zero + np.float32(self.high) - down
        for axis, middle, out in zip((i, j), self.centre, (first, second), strict=True):
            point[axis] = np.float32(middle) + np.float32(self.radius) * out
            normal[axis] = -out if self.vault else out
        return point, normal


@dataclass(frozen=True)
class Sphere:
    """Describe a ball, or the part of it that stands out of a wall."""

    centre: tuple[float, float, float]
    radius: float

    @property
    def size_m(self) -> tuple[float, float]:
        return 2 * math.pi * self.radius, math.pi * self.radius

    @property
    def box(self) -> F64:
        middle = np.array(self.centre)
        return np.stack((middle - self.radius, middle + self.radius))

    def faces(self, point: F64) -> bool:
        return True

    def hit(self, origin: Vector, direction: Vector) -> F32:
        out = [origin[k] - np.float32(self.centre[k]) for k in range(3)]
        a = sum((d * d for d in direction[1:]), direction[0] * direction[0])
        b = out[0] * direction[0] + out[1] * direction[1] + out[2] * direction[2]
        c = out[0] * out[0] + out[1] * out[1] + out[2] * out[2] - np.float32(self.radius**2)
        with np.errstate(invalid="ignore"):
            t = (-b - np.sqrt(b * b - a * c)) / a
            return np.where(t > _NEAREST_M, t, np.float32(np.inf))

    def locate(self, point: Vector) -> tuple[F32, F32]:
        x, y, z = ((point[k] - np.float32(self.centre[k])) / np.float32(self.radius) for k in range(3))
        longitude, colatitude = np.arctan2(x, -y), np.arccos(np.clip(z, -1, 1))
        radius = np.float32(self.radius)
        return (longitude + np.float32(math.pi)) * radius, colatitude * radius

    def surface(self, across: F32, down: F32) -> tuple[Vector, Vector]:
        longitude = across / np.float32(self.radius) - np.float32(math.pi)
        colatitude = down / np.float32(self.radius)
        ring = np.sin(colatitude)
        normal = [ring * np.sin(longitude), -ring * np.cos(longitude), np.cos(colatitude) + 0 * longitude]
        point = [np.float32(self.centre[k]) + np.float32(self.radius) * normal[k] for k in range(3)]
        return point, normal


Shape = Rect | Cylinder | Sphere


def corners_of(shape: Shape) -> F64:
    """Return (8, 3): the corners of a shape's bounding box."""
    return np.array(list(product(*shape.box.T)))
