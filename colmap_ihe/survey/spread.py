"""Tell how well cameras and named points are known after an adjustment with control: their covariances, by its normal
equations. Foerstner and Wrobel 2016, "Photogrammetric computer vision", 4.6 and 15.4."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.colmap.calibration.block import Block
from colmap_ihe.colmap.calibration.equations import solved
from colmap_ihe.colmap.calibration.lens import FreeCamera
from colmap_ihe.survey.control_equations import ControlTerms, rows_of_sights
from colmap_ihe.survey.observations import F64

_GAUGE = 1e-9  # of the scaled equations, in directions that nothing determines
_NOWHERE = 1e-9  # of one square metre: what is known of a point where no sight tells of it


@dataclass(frozen=True)
class State:
    """Hold poses and tie points, the cameras and their free parameters `values` (K,), and the named points (T, 3)."""

    block: Block
    cameras: Sequence[FreeCamera]
    values: F64
    points: F64


@dataclass(frozen=True)
class Spread:
    """Hold where an adjustment ended, and its normal equations (C, C): of six unknowns a pose, the K free parameters,
    and three of each named point, in units of variances."""

    state: State
    matrix: F64

    def of_points(self) -> F64:
        """Return the covariances (T, 3, 3) of the named points, with what cameras and poses leave open."""
        count = len(self.state.points)
        parts = np.zeros((3 * count, len(self.matrix)))
        parts[:, len(self.matrix) - 3 * count :] = np.eye(3 * count)
        return self._of(parts.reshape(count, 3, len(self.matrix)))

    def of_points_apart(self, terms: ControlTerms) -> F64:
        """Return the covariances (N, 3, 3) of the named points of `terms`, which took no part: of their sights, and of
        cameras and poses, through which the sights place them."""
        state, count = self.state, len(terms.located)
        rows = rows_of_sights(terms, state.block, state.cameras, state.values, terms.located)
        split = rows.jacobian.shape[1] - 3 * count
        by_cameras, by_points = rows.jacobian[:, :split], rows.jacobian[:, split:]
        of_sights = np.linalg.inv(by_points.T @ by_points + _NOWHERE * np.eye(3 * count))
        parts = np.zeros((3 * count, len(self.matrix)))
        parts[:, :split] = -of_sights @ by_points.T @ by_cameras
        each = 3 * np.arange(count)[:, None] + np.arange(3)
        own = of_sights[each[:, :, None], each[:, None, :]]
        return np.asarray(own) + self._of(parts.reshape(count, 3, len(self.matrix)))

    def of_cameras(self) -> list[list[float]]:
        """Return the standard deviations of the parameters of each camera, 0 of those that were held."""
        first = 6 * len(self.state.block.rotations)
        deviations = []
        for camera in self.state.cameras:
            parts = np.zeros((len(camera.basis), 1, len(self.matrix)))
            parts[:, 0, first : first + len(self.state.values)] = camera.basis
            deviations.append(np.sqrt(self._of(parts)[:, 0, 0]).tolist())
        return deviations

    def _of(self, parts: F64) -> F64:
        """Return the covariances (N, k, k) of combinations (N, k, C) of the unknowns."""
        count, size, unknowns = parts.shape
        columns = solution(self.matrix, parts.reshape(-1, unknowns).T, 0.0)
        return np.asarray(np.einsum("nic,cnj->nij", parts, columns.reshape(unknowns, count, size)))


def solution(matrix: F64, right: F64, damping: float) -> F64:
    """Return the solution (C, ...) of normal equations (C, C), damped by a share of their diagonal."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    scaled = matrix * scale[:, None] * scale
    scaled[np.diag_indices(len(scaled))] += max(damping, _GAUGE)
    across = scale if right.ndim == 1 else scale[:, None]
    return solved(scaled, right * across) * across
