"""Choose where the demo's photographs are taken from, and with which exposure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from colmap_ihe.evaluation.demo.grid import F64

FOCAL_LENGTH_35MM = 30
_SHUTTER = (Fraction(1, 125), Fraction(1, 100), Fraction(1, 160), Fraction(1, 125), Fraction(1, 100))
_NOMINAL_S = 1 / 125


@dataclass(frozen=True)
class DemoView:
    """Describe one photograph: a pinhole camera without distortion, principal point in the middle.

    Pixels as in COLMAP: the centre of the top left pixel is (0.5, 0.5). `cam_from_world` is
    (3, 4) float64, metres, camera x right, y down, z forward.
    """

    stem: str
    width: int
    height: int
    focal_px: float
    cam_from_world: F64
    exposure_time_s: Fraction

    @property
    def calibration(self) -> F64:
        """Return K, (3, 3)."""
        return np.array(((self.focal_px, 0, self.width / 2), (0, self.focal_px, self.height / 2), (0, 0, 1)))

    @property
    def centre(self) -> F64:
        """Return (3,): the projection centre in the world."""
        return np.asarray(-self.cam_from_world[:, :3].T @ self.cam_from_world[:, 3])

    @property
    def exposure(self) -> float:
        """Return the light on the sensor relative to the nominal exposure."""
        return float(self.exposure_time_s) / _NOMINAL_S


def arc_of_views(count: int, size: tuple[int, int]) -> list[DemoView]:
    """Return `count` views on an arc before the portico, at changing heights, the middle ones from nearer. From one to
    the next the camera moves mostly sideways, by a tenth of the distance in 14 views."""
    width, height = size
    focal_px = FOCAL_LENGTH_35MM / 36 * max(size)
    views = []
    for k in range(count):
        side = 2 * k / (count - 1) - 1 if count > 1 else 0.0  # from -1, left, to 1
        angle = math.radians(37) * side
        distance = 12.1 - 0.6 * math.cos(math.pi * side)
        eye_height = 2.4 + 0.6 * math.sin(9 * side)
        centre = np.array((distance * math.sin(angle), 1.2 - distance * math.cos(angle), eye_height))
        target = np.array((0.22 * centre[0], 1.2, 3.75 + 0.15 * math.sin(11 * side)))
        pose = looking(centre, target, roll=math.radians(0.8 * math.sin(19 * side)))
        exposure_time_s = _SHUTTER[k % len(_SHUTTER)]
        views.append(DemoView(f"portico_{k + 1:02d}", width, height, focal_px, pose, exposure_time_s))
    return views


def looking(centre: F64, target: F64, roll: float) -> F64:
    """Return (3, 4) cam_from_world of an upright camera turned by `roll` radians about its axis."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, (0, 0, 1))
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    turn = np.array(((math.cos(roll), math.sin(roll), 0), (-math.sin(roll), math.cos(roll), 0), (0, 0, 1)))
    rotation = turn @ np.stack((right, down, forward))
    return np.hstack((rotation, -(rotation @ centre)[:, None]))
