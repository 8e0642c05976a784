"""Compare a mesh with true surfaces, both as points on them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, PinholeCamera
from colmap_ihe.evaluation.truth import F32, F64, Similarity, TrueImage

_KD_TREE = 4  # FLANN's exact one, KDTreeSingleIndex


@dataclass(frozen=True)
class SurfaceErrors:
    """Hold distances in the unit of the points.

    `accuracy` (N,) float32: from each point of the mesh to the nearest true one; `completeness` (M,) float32: from
    each true point to the nearest of the mesh.
    """

    accuracy: F32
    completeness: F32

    def shares_percent(self, within: float) -> tuple[float, float]:
        """Return the shares of points of the mesh `within` a distance of the truth, and of true points of the mesh."""
        return 100 * float(np.mean(self.accuracy <= within)), 100 * float(
            np.mean(self.completeness <= within)
        )


def surface_errors(mesh_points: F32, true_points: F32) -> SurfaceErrors:
    """Compare (N, 3) and (M, 3) points in one frame, as dense as the distances that matter.

    Raises ValueError for other shapes, and where one of them has no point.
    """
    for name, points in (("mesh_points", mesh_points), ("true_points", true_points)):
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise ValueError(f"{name}.shape={points.shape}, expected (N, 3) with N > 0")
    return SurfaceErrors(_nearest(mesh_points, true_points), _nearest(true_points, mesh_points))


def _nearest(points: F32, among: F32) -> F32:
    tree = cv2.flann.Index(np.ascontiguousarray(among, np.float32), {"algorithm": _KD_TREE})
    _, squared = tree.knnSearch(np.ascontiguousarray(points, np.float32), 1, params={"checks": -1})
    return np.asarray(np.sqrt(np.maximum(squared[:, 0], 0)), np.float32)


def points_on(corners: F32, count: int, seed: int = 0) -> F32:
    """Return (count, 3) float32: random points on triangles (F, 3, 3), equally dense everywhere (Osada et al. 2002)."""
    draw = np.random.default_rng(seed)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = draw.choice(len(corners), count, p=area / area.sum())
    root, part = np.sqrt(draw.random(count)), draw.random(count)
    weights = np.stack((1 - root, root * (1 - part), root * part), axis=1)
    return np.asarray((corners[face] * weights[:, :, None]).sum(axis=1), np.float32)


def true_points(image: TrueImage, step: int = 1) -> F32:
    """Return (N, 3) float32: the point that each `step`-th pixel of a true image sees, in metres."""
    depth = image.depth_m()[::step, ::step]
    row, column = np.nonzero(depth)
    pixels = np.stack((column * step + 0.5, row * step + 0.5, np.ones(len(row))), axis=1)
    seen = pixels @ np.linalg.inv(image.calibration).T * depth[row, column][:, None]
    return np.asarray((seen - image.cam_from_world[:, 3]) @ image.cam_from_world[:, :3], np.float32)


def moved(points: F32 | F64, similarity: Similarity) -> F32:
    """Return (N, 3) float32: points in the frame that `similarity` leads to."""
    turned = points @ similarity.rotation.T
    return np.asarray(similarity.scale * turned + similarity.translation, np.float32)


def before_sky(points: F32, image: TrueImage) -> Bool:
    """Return (N,), true where a true image sees the sky, at and around the pixels of points (N, 3) in metres."""
    depth = image.depth_m()
    view = PinholeCamera(image.calibration, image.cam_from_world, depth.shape[::-1])
    pixels, distance = view.project(points)
    sky = cv2.erode((depth <= 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    with np.errstate(invalid="ignore"):
        inside = (distance > 0) & (pixels >= 0).all(axis=1) & (pixels < view.size).all(axis=1)
    column, row = np.where(inside[:, None], pixels, 0).astype(int).T
    return np.asarray(inside & (sky[row, column] > 0))
