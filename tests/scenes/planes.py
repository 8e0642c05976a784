"""Textured planes with known depth, seen by any pinhole camera: each ray is cut with each plane.

Independent of the code under test: no homography, no inverse depth.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float64, PinholeCamera, UInt8
from colmap_ihe.dense.stereo.views import StereoView

REFERENCE_SIZE = (400, 300)
FOCAL = 420.0


@dataclass(frozen=True)
class Plane:
    """Points origin + s * right + t * down with s, t within +-`half`; grey values come from `texture_u8`."""

    origin: Float64
    right: Float64
    down: Float64
    half: tuple[float, float]
    texture_u8: UInt8

    @property
    def normal(self) -> Float64:
        """Unit normal, towards a camera in front of the plane that looks along +z."""
        normal = np.cross(self.right, self.down)
        return np.asarray(-np.sign(normal[2]) * normal / np.linalg.norm(normal))


def plane(depth: float, slope_x: float, slope_y: float, half: tuple[float, float], seed: int) -> Plane:
    """z = depth + slope_x x + slope_y y around the z axis, with a random texture of 100 cells a unit."""
    origin = np.array([0.0, 0.0, depth])
    shape = (round(200 * half[1]) + 1, round(200 * half[0]) + 1)
    noise = np.random.default_rng(seed).normal(size=shape)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.0) + 2 * cv2.GaussianBlur(noise, (0, 0), 4.0)
    texture = np.clip(128 + 45 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    return Plane(origin, np.array([1, 0, slope_x]), np.array([0, 1, slope_y]), half, texture)


def camera(
    centre: Sequence[float],
    *,
    roll_deg: float = 0.0,
    yaw_deg: float = 0.0,
    size: tuple[int, int] = REFERENCE_SIZE,
    focal: float = FOCAL,
) -> PinholeCamera:
    """A camera at `centre` that looks along +z, first turned about y, then rolled about its own axis."""
    roll, yaw = np.radians([roll_deg, yaw_deg])
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array([[np.cos(roll), np.sin(roll), 0], [-np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    rotation = tilt @ turn
    translation = -rotation @ np.asarray(centre, float)
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return PinholeCamera(K, np.column_stack([rotation, translation]), size)


def render(seen_by: PinholeCamera, planes: Sequence[Plane], noise: float = 1.0) -> tuple[StereoView, Float64]:
    """What the camera sees, and its true depth (H, W), 0 where it sees nothing."""
    width, height = seen_by.size
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(seen_by.K).T @ seen_by.rotation
    depth = np.full((height, width), np.inf)
    grey = np.zeros((height, width))
    for one in planes:
        # centre + distance * ray = origin + s * right + t * down; a ray's distance is its depth.
        distance = ((one.origin - seen_by.centre) @ one.normal) / (rays @ one.normal)
        offset = seen_by.centre + distance[..., None] * rays - one.origin
        s, t = offset[..., 0], offset[..., 1]
        hit = (np.abs(s) < one.half[0]) & (np.abs(t) < one.half[1]) & (distance > 0) & (distance < depth)
        x, y = (s + one.half[0]) * 100, (t + one.half[1]) * 100
        values = cv2.remap(one.texture_u8, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)
        depth[hit], grey[hit] = distance[hit], values[hit]
    seed = zlib.crc32(seen_by.cam_from_world.tobytes())
    grey += np.random.default_rng(seed).normal(scale=noise, size=grey.shape)
    grey_u8 = np.clip(np.round(grey), 0, 255).astype(np.uint8)
    depth[~np.isfinite(depth)] = 0
    return StereoView(seen_by.K, seen_by.cam_from_world, seen_by.size, grey_u8), depth


def sparse_points(seen_by: PinholeCamera, depth: Float64, step: int = 15) -> Float64:
    """(N, 3): world points of every `step`th pixel that sees something."""
    v, u = np.mgrid[step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step].reshape(2, -1)
    z = depth[v, u]
    rays = np.column_stack([u + 0.5, v + 0.5, np.ones(len(u))]) @ np.linalg.inv(seen_by.K).T
    points = (rays * z[:, None] - seen_by.cam_from_world[:, 3]) @ seen_by.rotation
    return np.asarray(points[z > 0])
