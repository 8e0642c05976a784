"""Place a drawing in the model: on a plane, or on a cylinder that is unrolled.

A place on a drawing has three coordinates in units of the model: across (to the right), up, and out (towards who
looks at it). Whatever is drawn is done in these, so that a plane and a cylinder need no other code than this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from colmap_ihe.dense.camera import Float64

_LEAST = 1e-9  # length of a direction that is one


@dataclass(frozen=True)
class PlaneFrame:
    """Hold a plane by its `origin` (3,) and three unit vectors (3,) of the model: `right`, `up` and `normal`, which
    points to who looks at the drawing."""

    origin: Float64
    right: Float64
    up: Float64
    normal: Float64

    @property
    def turn(self) -> Float64:
        """Return the circumference after which a drawing comes back to where it began: a plane never does."""
        return np.asarray(np.inf)

    def to_drawing(self, points: Float64) -> Float64:
        """Return (..., 3), across, up and out of points (..., 3) of the model."""
        return np.asarray((np.asarray(points, np.float64) - self.origin) @ self._axes.T)

    def to_model(self, places: Float64) -> Float64:
        """Return (..., 3), points of the model at places (..., 3) of the drawing."""
        return np.asarray(np.asarray(places, np.float64) @ self._axes + self.origin)

    @property
    def _axes(self) -> Float64:
        return np.stack((self.right, self.up, self.normal))


@dataclass(frozen=True)
class CylinderFrame:
    """Hold a cylinder by a point `origin` (3,) on its axis, the unit vectors (3,) `axis` (up) and `start` (from the
    axis to the middle of the drawing), and its `radius`. `inside`: seen from its axis, as an apse."""

    origin: Float64
    axis: Float64
    start: Float64
    radius: float
    inside: bool = False

    @property
    def turn(self) -> Float64:
        """Return the circumference, after which a drawing comes back to where it began."""
        return np.asarray(2 * np.pi * self.radius)

    def to_drawing(self, points: Float64) -> Float64:
        """Return (..., 3), across, up and out of points (..., 3) of the model. Across is the arc on the cylinder, from
        minus to plus half its circumference."""
        apart = np.asarray(points, np.float64) - self.origin
        ahead, aside = apart @ self.start, apart @ self._side
        across = np.arctan2(aside, ahead) * self.radius * self._sign
        out = (np.hypot(ahead, aside) - self.radius) * self._sign
        return np.stack((across, apart @ self.axis, out), axis=-1)

    def to_model(self, places: Float64) -> Float64:
        """Return (..., 3), points of the model at places (..., 3) of the drawing."""
        across, up, out = np.moveaxis(np.asarray(places, np.float64), -1, 0)[..., None]
        angle, distance = across / self.radius * self._sign, self.radius + out * self._sign
        around = np.cos(angle) * self.start + np.sin(angle) * self._side
        return np.asarray(self.origin + distance * around + up * self.axis)

    @property
    def _side(self) -> Float64:
        return np.cross(self.axis, self.start)

    @property
    def _sign(self) -> float:
        return -1.0 if self.inside else 1.0


DrawingFrame: TypeAlias = PlaneFrame | CylinderFrame


def plane_frame(point: Float64, normal: Float64, up: Float64) -> PlaneFrame:
    """Return the frame of a plane through `point` (3,) that looks along `normal` (3,): upright where the plane is not
    level, else with y of the model upwards, as on a map. Its origin is where the model's own falls on it, at height
    zero if it is upright: across and up are x and y of a plan, and up is the height on a façade. Raises ValueError for
    a normal of no length."""
    normal, up = _unit(normal), _unit(up)
    level = np.asarray(up - (up @ normal) * normal)
    if np.linalg.norm(level) < 0.02:  # a degree: seen from above
        level = np.array((0.0, 1.0, 0.0)) if abs(up[2]) > 0.5 else np.array((0.0, 0.0, 1.0))
        level = level - (level @ normal) * normal
    upward = _unit(level)
    origin = np.asarray((point @ normal) * normal, np.float64)
    if abs(up @ upward) > 0.02:
        origin = origin - (origin @ up) / (up @ upward) * upward
    return PlaneFrame(origin, np.cross(upward, normal), upward, normal)


def plane_of_points(points: Sequence[Float64], up: Float64, seen_from: Float64) -> PlaneFrame:
    """Return the frame of the plane through three points (3,), seen from the side of the point `seen_from` (3,). Raises
    ValueError where they lie on a line."""
    first, second, third = (np.asarray(point, np.float64) for point in points)
    normal = np.cross(second - first, third - first)
    longest = max(float(np.linalg.norm(second - first)), float(np.linalg.norm(third - first)))
    if np.linalg.norm(normal) <= 1e-6 * longest**2:
        raise ValueError("the three points lie on a line")
    if normal @ (seen_from - first) < 0:
        normal = -normal
    return plane_frame(first, normal, up)


def cylinder_frame(
    point: Float64, axis: Float64, radius: float, up: Float64, seen_from: Float64, *, inside: bool = False
) -> CylinderFrame:
    """Return the frame of a cylinder whose drawing has the side towards `seen_from` (3,) in its middle; of one seen
    from `inside` the side away from it. Its origin is at height zero if it is not level. Raises ValueError for an axis
    or a radius of no length."""
    axis = _unit(axis)
    axis = -axis if axis @ up < 0 else axis
    if axis @ up > 0.02:
        point = np.asarray(point - (point @ up) / (axis @ up) * axis)
    if not radius > 0:
        raise ValueError(f"a radius of {radius:g}")
    towards = np.asarray(seen_from - point, np.float64)
    towards = towards - (towards @ axis) * axis
    if np.linalg.norm(towards) < _LEAST:
        towards = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
    start = _unit(-towards if inside else towards)
    return CylinderFrame(np.asarray(point, np.float64), axis, start, float(radius), inside)


def _unit(vector: Float64) -> Float64:
    vector = np.asarray(vector, np.float64)
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length < _LEAST:
        raise ValueError("a direction of no length")
    return np.asarray(vector / length)
