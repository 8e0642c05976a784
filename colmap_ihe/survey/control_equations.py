"""Set up the equations of what a survey adds to an adjustment: named points, where they are seen, their surveyed
places, scale bars and camera positions.

The unknowns are six of each pose (a turn before it, a shift after it), the free parameters of the cameras, and three
of each named point, in this order; those of tie points are eliminated before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.calibration.block import Block
from colmap_ihe.colmap.calibration.lens import FreeCamera, derivatives
from colmap_ihe.colmap.calibration.robust import robust_cost, weights_of
from colmap_ihe.survey.observations import F64

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class ControlTerms:
    """Hold what is measured, in metres and pixels, each with its standard deviations.

    Of T named points `located` (T, 3), where the model has them, `surveyed` (T, 3) and `accuracy_m` (T,), infinite for
    one that is only seen; of S sights `image` and `point` (S,), `pixels` (S, 2) and `accuracy_px` (S,); of B bars
    `ends` (B, 2), `lengths` and `bar_accuracy_m` (B,); of Q camera positions `at` (Q,), `centres` (Q, 3) and
    `centre_accuracy_m` (Q,). Points and images are told by their numbers.
    """

    located: F64
    surveyed: F64
    accuracy_m: F64
    image: Ints
    point: Ints
    pixels: F64
    accuracy_px: F64
    ends: Ints
    lengths: F64
    bar_accuracy_m: F64
    at: Ints
    centres: F64
    centre_accuracy_m: F64


@dataclass(frozen=True)
class Rows:
    """Hold weighted residuals (R,) and their derivatives (R, C); `cost`: the robust cost of all, in units of their
    variances."""

    residuals: F64
    jacobian: F64
    cost: float


def rows_of(
    terms: ControlTerms, block: Block, cameras: Sequence[FreeCamera], values: F64, points: F64
) -> Rows:
    """Return the rows of everything measured, at the poses of `block`, the free parameters `values` (K,) and the named
    points (T, 3)."""
    size = 6 * len(block.rotations) + len(values) + 3 * len(points)
    first = size - 3 * len(points)
    parts = [
        rows_of_sights(terms, block, cameras, values, points),
        _surveyed(terms, points, first, size),
        _bars(terms, points, first, size),
        _positions(terms, block, size),
    ]
    return Rows(
        np.concatenate([part.residuals for part in parts]),
        np.concatenate([part.jacobian for part in parts]),
        sum(part.cost for part in parts),
    )


def rows_of_sights(
    terms: ControlTerms, block: Block, cameras: Sequence[FreeCamera], values: F64, points: F64
) -> Rows:
    """Return the rows of where the named points (T, 3) are seen, and nothing else of `terms`."""
    size = 6 * len(block.rotations) + len(values) + 3 * len(points)
    sights = replace(block, points=points, image=terms.image, point=terms.point, pixels=terms.pixels)
    seen = derivatives(sights, cameras, values)
    scaled = seen.residuals / terms.accuracy_px[:, None]
    root = (np.sqrt(weights_of(scaled, 1.0)) / terms.accuracy_px)[:, None, None]
    usable = root > 0
    by_point = np.where(usable, seen.by_point, 0.0) * root
    arms = seen.in_camera - block.translations[terms.image]
    by_pose = np.concatenate([np.cross(arms[:, None, :], by_point), by_point], axis=2)
    count = len(terms.image)
    jacobian = np.zeros((count, 2, size))
    number = np.arange(count)[:, None]
    poses, free = 6 * len(block.rotations), len(values)
    jacobian[number, :, 6 * terms.image[:, None] + np.arange(6)] = by_pose.transpose(0, 2, 1)
    jacobian[:, :, poses : poses + free] = np.where(usable, np.nan_to_num(seen.by_free), 0.0) * root
    by_world = by_point @ block.rotations[terms.image]
    columns = poses + free + 3 * terms.point[:, None] + np.arange(3)
    jacobian[number, :, columns] = by_world.transpose(0, 2, 1)
    residuals = np.where(usable[..., 0], np.nan_to_num(seen.residuals), 0.0) * root[..., 0]
    return Rows(residuals.ravel(), jacobian.reshape(2 * count, size), float(robust_cost(scaled, 1.0).sum()))


def _surveyed(terms: ControlTerms, points: F64, first: int, size: int) -> Rows:
    known = np.flatnonzero(np.isfinite(terms.accuracy_m))
    residuals = (points[known] - terms.surveyed[known]) / terms.accuracy_m[known, None]
    jacobian = np.zeros((len(known), 3, size))
    for axis in range(3):
        jacobian[np.arange(len(known)), axis, first + 3 * known + axis] = 1 / terms.accuracy_m[known]
    return Rows(residuals.ravel(), jacobian.reshape(-1, size), float((residuals**2).sum()))


def _bars(terms: ControlTerms, points: F64, first: int, size: int) -> Rows:
    apart = points[terms.ends[:, 1]] - points[terms.ends[:, 0]]
    lengths = np.linalg.norm(apart, axis=1)
    residuals = (lengths - terms.lengths) / terms.bar_accuracy_m
    along = apart / np.maximum(lengths, 1e-12)[:, None] / terms.bar_accuracy_m[:, None]
    jacobian = np.zeros((len(lengths), size))
    number = np.arange(len(lengths))
    for axis in range(3):
        jacobian[number, first + 3 * terms.ends[:, 1] + axis] = along[:, axis]
        jacobian[number, first + 3 * terms.ends[:, 0] + axis] = -along[:, axis]
    return Rows(residuals, jacobian, float((residuals**2).sum()))


def _positions(terms: ControlTerms, block: Block, size: int) -> Rows:
    """Return the rows of camera positions. With the pose turned by w before and shifted by d after it, the centre
    -R't moves by -R'(d + [t] w)."""
    rotations, translations = block.rotations[terms.at], block.translations[terms.at]
    centres = -np.einsum("qji,qj->qi", rotations, translations)
    away = (centres - terms.centres) / terms.centre_accuracy_m[:, None]
    lengths = np.linalg.norm(away, axis=1)
    pairs = np.stack((lengths, np.zeros(len(lengths))), axis=1)
    root = np.sqrt(weights_of(pairs, 1.0))[:, None]
    back = -rotations.transpose(0, 2, 1) / terms.centre_accuracy_m[:, None, None]
    by_pose = np.concatenate([back @ _crossing(translations), back], axis=2) * root[..., None]
    jacobian = np.zeros((len(away), 3, size))
    number = np.arange(len(away))[:, None]
    jacobian[number, :, 6 * terms.at[:, None] + np.arange(6)] = by_pose.transpose(0, 2, 1)
    return Rows((away * root).ravel(), jacobian.reshape(-1, size), float(robust_cost(pairs, 1.0).sum()))


def _crossing(vectors: F64) -> F64:
    """Return (Q, 3, 3): the matrices whose product with w is the cross product of vectors (Q, 3) with w."""
    x, y, z = vectors.T
    none = np.zeros(len(vectors))
    return np.stack([np.stack(row, axis=1) for row in ((none, -z, y), (z, none, -x), (-y, x, none))], axis=1)
