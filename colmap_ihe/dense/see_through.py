"""Cut out of a surface what photographs see through: what Poisson closes, as windows and the gaps of balustrades."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Bool, Float32, Int64, PinholeCamera
from colmap_ihe.dense.depth_maps import camera_of, depth_file, read_planes
from colmap_ihe.dense.texture.mesh import Mesh, components, neighbours
from colmap_ihe.machine.progress import SILENT, Progress

_BEYOND = 0.005  # relative depth behind a face of what is seen through it
_LEAST_VIEWS = 2  # that see through it
_LEAST_FACES = 12  # of a hole: less is noise of the depth


def without_seen_through(mesh: Mesh, dense_dir: Path, progress: Progress = SILENT) -> Mesh:
    """Return `mesh` without the faces through which at least two depth maps of `dense_dir`, and more than see the face
    itself, show what is behind. Small holes stay closed. Raises `ProjectError`, `Cancelled`."""
    if not len(mesh.faces):
        return mesh
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    centres = mesh.corners().mean(axis=1)
    through, support = np.zeros((2, len(centres)), np.int32)
    for number in sorted(model.reg_image_ids()):
        progress.check()
        file = depth_file(dense_dir, str(model.images[number].name))
        if file.is_file():
            beyond, at_it = _seen(centres, camera_of(model, number), read_planes(file)[0])
            through += beyond
            support += at_it
    open_ = (through >= _LEAST_VIEWS) & (through > support)
    return mesh.with_faces(~_large(open_, neighbours(mesh.faces)))


def _seen(centres: Float32, view: PinholeCamera, depth: Float32) -> tuple[Bool, Bool]:
    """Return (F,), true where all depths within a pixel of a face's centre are beyond it, and where one is at it."""
    pixels, distance = view.project(centres)
    width, height = view.size
    with np.errstate(invalid="ignore"):
        column, row = np.floor(pixels).T
        inside = (distance > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    column, row = (np.where(inside, values, 0).astype(np.intp) for values in (column, row))
    nearest = cv2.erode(np.asarray(depth), np.ones((3, 3), np.uint8))  # 0 beside what has none
    beyond = inside & (nearest[row, column] > (1 + _BEYOND) * distance)
    at_it = inside & (np.abs(depth[row, column] - distance) <= _BEYOND * distance)
    return beyond, at_it


def _large(chosen: Bool, pairs: Int64) -> Bool:
    """Return those of the faces `chosen` (F,) that hang together in `_LEAST_FACES` and more; `pairs` (E, 2) are
    neighbours."""
    patch = components(len(chosen), pairs[chosen[pairs].all(axis=1)])
    return np.asarray(chosen & (np.bincount(patch)[patch] >= _LEAST_FACES))
