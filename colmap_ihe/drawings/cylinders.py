"""Fit an upright cylinder to a mesh: towers, apses, columns."""

from __future__ import annotations

import numpy as np

from colmap_ihe.dense.camera import Float64
from colmap_ihe.dense.texture.mesh import Mesh, face_normals
from colmap_ihe.drawings.frames import plane_frame

_WITHIN = 0.35  # of the radius that was given, from which faces may be
_ROUND = 0.8  # cosine between the normal of a face and the direction from the axis, of a face of a cylinder
_ROUNDS = 12
_FEWEST = 20  # faces


def fitted_cylinder(mesh: Mesh, up: Float64, point: Float64, radius: float) -> tuple[Float64, float]:
    """Return a point (3,) on the axis and the radius of the upright cylinder nearest to that through `point` (3,) of
    about that `radius`: least squares over the faces near it that look to its axis or away from it, by area, each round
    with those that are nearer. Raises ValueError where there are too few."""
    frame = plane_frame(np.zeros(3), up, up)
    corners = mesh.corners()
    normals = face_normals(corners)
    area = np.linalg.norm(normals, axis=1)
    places = frame.to_drawing(corners.mean(axis=1, dtype=np.float64))
    looks = normals @ np.stack((frame.right, frame.up), axis=1) / np.maximum(area, 1e-300)[:, None]
    flat = places[:, :2]
    middle = frame.to_drawing(np.asarray(point, np.float64))
    centre, size, within = middle[:2].copy(), float(radius), _WITHIN
    level = np.abs(places[:, 2] - middle[2]) < max(4 * radius, 1e-9)
    for _ in range(_ROUNDS):
        apart = flat - centre
        distance = np.linalg.norm(apart, axis=1)
        facing = np.abs((looks * apart).sum(axis=1)) > _ROUND * np.maximum(distance, 1e-300)
        near = level & facing & (np.abs(distance - size) < within * size)
        if near.sum() < _FEWEST:
            raise ValueError(
                f"only {near.sum()} faces of the mesh are of an upright cylinder of {radius:g} about that point"
            )
        weight = np.sqrt(area[near])
        unit = apart[near] / distance[near, None]
        system = np.column_stack((unit, np.ones(near.sum()))) * weight[:, None]
        step, *_ = np.linalg.lstsq(system, (distance[near] - size) * weight, rcond=None)
        centre, size = centre + step[:2], size + float(step[2])
        if not 0.5 * radius < size < 2 * radius:
            raise ValueError(f"no upright cylinder of about {radius:g} is there; the fit went to {size:.3g}")
        within = max(0.7 * within, 0.05)
    return frame.to_model(np.array((*centre, middle[2]))), size
