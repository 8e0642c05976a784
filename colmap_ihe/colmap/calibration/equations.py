"""Set up and solve the normal equations of an adjustment, with the points eliminated (Schur complement).

Triggs et al. 2000, "Bundle adjustment: a modern synthesis", section 6. With neighbouring points next to one another in
a block, some thousand touch few images, and their part of the equations is a small dense matrix.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_ihe.colmap.calibration.block import Block, Float64
from colmap_ihe.colmap.calibration.lens import Terms
from colmap_ihe.colmap.calibration.robust import weights_of
from colmap_ihe.colmap.native import pycolmap

_CHUNK = 2000  # points that are eliminated at a time
_GAUGE = 1e-9  # of the scaled equations, in the seven directions that change nothing
_PARTS = 5  # of the picture, across and down


@dataclass(frozen=True)
class Prior:
    """Hold what is known of the free parameters beforehand: `mean` (K,) and `deviation` (K,), infinite for nothing."""

    mean: Float64
    deviation: Float64

    def cost(self, values: Float64) -> float:
        """Return what `values` (K,) cost."""
        return float((((values - self.mean) / self.deviation) ** 2).sum())


@dataclass(frozen=True)
class System:
    """Hold normal equations with the points eliminated: `matrix` (C, C), `gradient` (C,) over six of each pose and
    then the free parameters; and what places the points afterwards: `factors` (P, 3, 3), the inverse of L of V = L L',
    `right` (P, 3), and weighted `residuals` and derivatives."""

    matrix: Float64
    gradient: Float64
    scale: Float64
    factors: Float64
    right: Float64
    by_world: Float64
    by_pose: Float64
    by_free: Float64
    residuals: Float64


def weighted(block: Block, terms: Terms, sigma: float) -> tuple[Float64, Float64, Float64, Float64]:
    """Return derivatives by the point in the world and in the camera, those by the free parameters, and residuals, each
    times the root of its observation's weight; 0 where it has no projection."""
    root = (np.sqrt(weights_of(terms.residuals, sigma)) / sigma)[:, None]
    usable = root > 0
    residuals = np.where(usable, terms.residuals, 0.0) * root
    by_point = np.where(usable[..., None], terms.by_point, 0.0) * root[..., None]
    by_free = np.nan_to_num(terms.by_free) * root[..., None]
    return by_point @ block.rotations[block.image], by_point, by_free, residuals


def system_of(
    block: Block, terms: Terms, sigma: float, prior: Prior, values: Float64, damping: float
) -> System:
    by_world, by_point, by_free, residuals = weighted(block, terms, sigma)
    arms = terms.in_camera - block.translations[block.image]
    # By a turn w before the pose: the point moves by w x (R X), so by_point times that.
    by_pose = np.concatenate([np.cross(arms[:, None, :], by_point), by_point], axis=2)
    matrix, gradient = _of_cameras(block, by_pose, by_free, residuals)
    tail = slice(6 * len(block.rotations), len(gradient))
    matrix[tail, tail] += np.diag(prior.deviation**-2.0)
    gradient[tail] += (values - prior.mean) * prior.deviation**-2.0
    squares = sums(block, by_world.transpose(0, 2, 1) @ by_world)
    squares[:, range(3), range(3)] += (damping + 1e-9) * np.trace(squares, axis1=1, axis2=2)[:, None] + 1e-12
    factors = np.linalg.inv(np.linalg.cholesky(squares))
    right = sums(block, np.einsum("mki,mk->mi", by_world, residuals))
    own = np.einsum("pij,pj->pi", factors, right)
    with_pose = (factors[block.point] @ by_world.transpose(0, 2, 1)) @ by_pose
    with_free = factors @ sums(block, by_world.transpose(0, 2, 1) @ by_free)
    for first in range(0, len(block.points), _CHUNK):
        _eliminate(block, slice(first, first + _CHUNK), own, with_pose, with_free, matrix, gradient)
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    return System(matrix, gradient, scale, factors, right, by_world, by_pose, by_free, residuals)


def sums(block: Block, values: Float64) -> Float64:
    """Return the sums (P, ...) over the observations of each point."""
    return np.add.reduceat(values, block.starts[:-1], axis=0)


def _of_cameras(
    block: Block, by_pose: Float64, by_free: Float64, residuals: Float64
) -> tuple[Float64, Float64]:
    images, count = len(block.rotations), by_free.shape[2]
    matrix = np.zeros((6 * images + count, 6 * images + count))
    gradient = np.zeros(6 * images + count)
    order = np.argsort(block.image, kind="stable")
    bounds = np.searchsorted(block.image[order], np.arange(images + 1))
    tail = np.arange(6 * images, 6 * images + count)
    for image in range(images):
        mine = order[bounds[image] : bounds[image + 1]]
        flat = np.concatenate([by_pose[mine], by_free[mine]], axis=2).reshape(-1, 6 + count)
        columns = np.concatenate([np.arange(6 * image, 6 * image + 6), tail])
        matrix[np.ix_(columns, columns)] += flat.T @ flat
        gradient[columns] += flat.T @ residuals[mine].ravel()
    return matrix, gradient


def _eliminate(
    block: Block,
    chunk: slice,
    own: Float64,
    with_pose: Float64,
    with_free: Float64,
    matrix: Float64,
    gradient: Float64,
) -> None:
    """Subtract what a chunk of points has in common from `matrix` and `gradient`, in the columns of its images only."""
    own, with_free = own[chunk], with_free[chunk]
    mine = slice(block.starts[chunk.start], block.starts[min(chunk.stop, len(block.points))])
    seen, column = np.unique(block.image[mine], return_inverse=True)
    size = 6 * len(seen)
    crossed = np.zeros((len(own), 3, size + with_free.shape[2]))
    crossed[:, :, size:] = with_free
    poses = crossed[:, :, :size].reshape(len(own), 3, len(seen), 6)  # of the same memory
    poses[block.point[mine] - chunk.start, :, column] = with_pose[mine]
    flat = crossed.reshape(-1, crossed.shape[2])
    tail = np.arange(6 * len(block.rotations), len(gradient))
    columns = np.concatenate([(6 * seen[:, None] + np.arange(6)).ravel(), tail])
    matrix[np.ix_(columns, columns)] -= flat.T @ flat
    gradient[columns] -= flat.T @ own.ravel()


def solve(system: System, damping: float) -> tuple[Float64, float]:
    """Return the move (C,) of poses and free parameters, and what the cost should gain by it."""
    scaled = system.matrix * system.scale[:, None] * system.scale
    scaled[np.diag_indices(len(scaled))] += max(damping, 1e-9)
    move = -solved(scaled, system.gradient * system.scale) * system.scale
    own = np.einsum("pij,pj->pi", system.factors, system.right)
    return move, float(-system.gradient @ move + (own**2).sum())


def solved(matrix: Float64, right: Float64) -> Float64:
    """Return the solution (n, ...) of equations (n, n); of those that are singular the shortest."""
    try:
        solution = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return np.asarray(solution, np.float64)


def moved(block: Block, values: Float64, system: System, move: Float64) -> tuple[Block, Float64]:
    poses = move[: 6 * len(block.rotations)].reshape(-1, 6)
    free = move[6 * len(block.rotations) :]
    along = np.einsum("mkj,mj->mk", system.by_pose, poses[block.image]) + system.by_free @ free
    right = system.right + sums(block, np.einsum("mki,mk->mi", system.by_world, along))
    points = (system.factors.transpose(0, 2, 1) @ (system.factors @ right[..., None]))[..., 0]
    turns = np.stack([pycolmap.Rotation3d(turn).matrix() for turn in poses[:, :3]])
    moved = replace(
        block,
        rotations=turns @ block.rotations,
        translations=block.translations + poses[:, 3:],
        points=block.points - points,
    )
    return moved, values + free


def without_poses(system: System) -> tuple[Float64, Float64]:
    """Return the normal equations of the free parameters alone, (K, K) and (K,), with the poses eliminated too."""
    count = system.by_free.shape[2]
    scaled = system.matrix * system.scale[:, None] * system.scale
    scaled[np.diag_indices(len(scaled))] += _GAUGE
    gradient = system.gradient * system.scale
    poses, free = slice(0, len(scaled) - count), slice(len(scaled) - count, len(scaled))
    moved_poses = solved(scaled[poses, poses], np.column_stack([scaled[poses, free], gradient[poses]]))
    matrix = scaled[free, free] - scaled[free, poses] @ moved_poses[:, :-1]
    gradient = gradient[free] - scaled[free, poses] @ moved_poses[:, -1]
    back = 1 / system.scale[free]
    return matrix * back[:, None] * back, gradient * back


def inverse_of(system: System) -> Float64:
    """Return (C, K): the columns of the free parameters of the inverse of the normal equations, in any gauge."""
    count = system.by_free.shape[2]
    scaled = system.matrix * system.scale[:, None] * system.scale
    scaled[np.diag_indices(len(scaled))] += _GAUGE
    free = np.arange(len(scaled) - count, len(scaled))
    columns = solved(scaled, np.eye(len(scaled))[:, free])
    return np.asarray(columns * system.scale[:, None] * system.scale[free])


def covariance(block: Block, system: System) -> Float64:
    """Return the covariance (K, K) of the free parameters, the same in any gauge: the larger, by each parameter's
    variance, of that of independent observations and those where the errors at a point, or in a part of the picture,
    are alike (White 1980, "A heteroskedasticity-consistent covariance matrix estimator")."""
    count = system.by_free.shape[2]
    poses, own = np.split(inverse_of(system), [len(system.matrix) - count])
    if own.size == 0 or len(block.pixels) == 0:
        return own
    by_pose = poses.reshape(-1, 6, count)
    along = np.einsum("mkj,mji->mki", system.by_pose, by_pose[block.image]) + system.by_free @ own
    moved_points = sums(block, system.by_world.transpose(0, 2, 1) @ along)
    moved_points = np.einsum("pji,pjk,pkl->pil", system.factors, system.factors, moved_points, optimize=True)
    along -= system.by_world @ moved_points[block.point]
    scores = np.einsum("mki,mk->mi", along, system.residuals)
    low, high = block.pixels.min(axis=0), block.pixels.max(axis=0)
    column, row = ((block.pixels - low) / np.maximum(high - low, 1) * _PARTS * 0.9999).astype(np.intp).T
    found: list[Float64] = [own]
    for group in (block.point, row * _PARTS + column):
        total: Float64 = np.stack([np.bincount(group, scores[:, k]) for k in range(count)], axis=1)
        found.append(total.T @ total)
    variances = np.array([np.diag(one) for one in found])
    widest = np.sqrt(variances.max(axis=0) / np.maximum(variances[0], 1e-300))
    return np.asarray(found[0] * widest[:, None] * widest)
