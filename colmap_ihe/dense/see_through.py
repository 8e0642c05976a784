"""Cut out of a surface what photographs show not to be there: what Poisson closes, as windows and the gaps of
balustrades, and what it adds beyond an edge, where the sky has no depth."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Int64, PinholeCamera
from colmap_ihe.dense.depth_maps import DepthMap, depth_maps
from colmap_ihe.dense.stereo.rims import plain_ground
from colmap_ihe.dense.texture.mesh import Mesh, components, neighbours
from colmap_ihe.dense.undistort import read_colour
from colmap_ihe.grey.weights import FIXED
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers

_BEYOND = 0.005  # relative depth behind a face of what is seen through it
_LEAST_VIEWS = 2  # that see through it
_ROUNDS = 4
_LEAST_FACES = 12  # of a hole, and of what is left: less is noise of the depth


def without_seen_through(mesh: Mesh, dense_dir: Path, progress: Progress = SILENT) -> Mesh:
    """Return `mesh` without the faces through which at least two depth maps of `dense_dir`, and more than see the face
    itself, show what is behind; small holes stay closed. And without those at its border at which two find nothing, or
    what is behind, and none the face, or at which two photographs, and more than see the face itself, show plain ground
    without depth, as the sky is. Crumbs that then hang by a corner go. Raises `ProjectError`, `Cancelled`."""
    if not len(mesh.faces):
        return mesh
    centres = mesh.middles
    through, support, empty, outside = np.zeros((4, len(centres)), np.int32)

    def look(depths: DepthMap) -> tuple[Bool, Bool, Bool, Bool]:
        depth, photograph = depths.read(), read_colour(depths.photograph)
        grey = np.asarray(cv2.transform(photograph, np.array([FIXED["rec709"]])), np.uint8)
        return _seen(centres, depths.camera, depth, plain_ground(grey, depth))

    with ThreadPoolExecutor(local_workers()) as threads:
        for beyond, at_it, nothing, on_ground in in_order(
            threads, look, depth_maps(dense_dir), progress=progress
        ):
            through += beyond
            support += at_it
            empty += nothing
            outside += on_ground
    pairs = neighbours(mesh.faces)
    open_ = (through >= _LEAST_VIEWS) & (through > support)
    unseen = (support == 0) & (through + empty >= _LEAST_VIEWS)
    unseen |= (outside >= _LEAST_VIEWS) & (outside > support)
    kept = ~(_large(open_, pairs) | _at_border(_smooth(unseen, pairs), pairs))
    return mesh.with_faces(_large(kept, pairs))


def _seen(
    centres: Float32, view: PinholeCamera, depth: Float32, ground: Bool
) -> tuple[Bool, Bool, Bool, Bool]:
    """Return (F,), true where all depths within a pixel of a face's centre are beyond it, where one is at it, where
    there is none, and where one of these pixels is plain ground: what shows there is not the face."""
    pixels, distance = view.project(centres)
    width, height = view.size
    with np.errstate(invalid="ignore"):
        column, row = np.floor(pixels).T
        inside = (distance > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    column, row = (np.where(inside, values, 0).astype(np.intp) for values in (column, row))
    around = np.ones((3, 3), np.uint8)
    nearest = cv2.erode(np.asarray(depth), around)[row, column]  # 0 beside what has none
    farthest = cv2.dilate(np.asarray(depth), around)[row, column]
    beyond = inside & (nearest > (1 + _BEYOND) * distance)
    on_ground = inside & (cv2.dilate(ground.astype(np.uint8), around)[row, column] > 0)
    at_it = inside & ~on_ground & (np.abs(depth[row, column] - distance) <= _BEYOND * distance)
    return beyond, at_it, inside & (farthest == 0), on_ground


def _large(chosen: Bool, pairs: Int64) -> Bool:
    """Return those of the faces `chosen` (F,) that hang together in `_LEAST_FACES` and more; `pairs` (E, 2) are
    neighbours."""
    patch = components(len(chosen), pairs[chosen[pairs].all(axis=1)])
    return np.asarray(chosen & (np.bincount(patch)[patch] >= _LEAST_FACES))


def _smooth(chosen: Bool, pairs: Int64) -> Bool:
    """Return (F,), each face as most of itself and its neighbours are, some times over: so a cut is no saw."""
    sides = 1 + np.bincount(pairs.ravel(), minlength=len(chosen))
    for _ in range(_ROUNDS):
        alike = np.bincount(pairs[:, 0], chosen[pairs[:, 1]], len(chosen))
        alike += np.bincount(pairs[:, 1], chosen[pairs[:, 0]], len(chosen))
        chosen = 2 * (alike + chosen) > sides
    return chosen


def _at_border(chosen: Bool, pairs: Int64) -> Bool:
    """Return those of the faces `chosen` (F,) that hang together with one at a border of the mesh, which has fewer than
    three neighbours."""
    patch = components(len(chosen), pairs[chosen[pairs].all(axis=1)])
    border = np.bincount(pairs.ravel(), minlength=len(chosen)) < 3
    return np.asarray(chosen & (np.bincount(patch[chosen & border], minlength=len(chosen))[patch] > 0))
