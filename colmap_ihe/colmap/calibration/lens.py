"""Say which parameters of COLMAP's cameras are free, tied or held, and how a projection changes with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.calibration.block import Block, Float64
from colmap_ihe.colmap.field_of_view import certain
from colmap_ihe.colmap.native import parameter_names, pycolmap

_STEP = 1e-6
"""Of the distance of a point along the axis, and ten times that of a coefficient, in numeric derivatives."""
_VECTORS = (("p2", "p1"), ("p0", "p1"), ("sx1", "sy1"), ("s0", "s2"), ("s1", "s3"))
"""Coefficients of COLMAP's models that are an error across and the same down."""


@dataclass(frozen=True)
class FreeCamera:
    """Hold a camera and how its parameters follow from those that are free in the set, K of them: those of `camera`
    and `basis` (n, K) times the free ones. So f may move fx and fy alike, and one f two cameras."""

    camera: pycolmap.Camera
    basis: Float64

    def at(self, values: Float64) -> pycolmap.Camera:
        """Return the camera with the free parameters at `values` (K,)."""
        return with_params(self.camera, np.asarray(self.camera.params) + self.basis @ values)


@dataclass(frozen=True)
class Terms:
    """Hold, of M observations, `in_camera` (M, 3), `residuals` (M, 2) in pixels, and the derivatives of the projection
    by the point in the camera (M, 2, 3) and by the free parameters (M, 2, K). Where a point has no projection or no
    derivative, its residual is nan."""

    in_camera: Float64
    residuals: Float64
    by_point: Float64
    by_free: Float64


def with_params(camera: pycolmap.Camera, params: Float64) -> pycolmap.Camera:
    changed = copy(camera)
    changed.params = params.tolist()
    return changed


def derivatives(block: Block, free: Sequence[FreeCamera], values: Float64) -> Terms:
    """Return residuals and derivatives of all observations, with the free parameters at `values` (K,)."""
    points = block.in_camera()
    count = len(points)
    residuals, by_point = np.zeros((count, 2)), np.zeros((count, 2, 3))
    by_free = np.zeros((count, 2, len(values)))
    camera_of = block.cameras[block.image]
    for number, one in enumerate(free):
        mine = np.flatnonzero(camera_of == number) if len(free) > 1 else slice(None)
        xyz = points[mine]
        if not len(xyz):
            continue
        camera = one.at(values)
        at = np.asarray(camera.img_from_cam(xyz))
        residuals[mine] = at - block.pixels[mine]
        with np.errstate(all="ignore"):  # at the limits of a projection; what is not finite is left out below
            by_point[mine] = _by_point(camera, xyz)
            if one.basis.any():  # not of cameras that are held
                by_params = _by_params(camera, xyz, at).reshape(-1, len(one.basis))
                by_free[mine] = (by_params @ one.basis).reshape(len(xyz), 2, -1)
    residuals[~_finite(residuals, by_point, by_free)] = np.nan
    return Terms(points, residuals, by_point, by_free)


def _finite(*arrays: Float64) -> NDArray[np.bool_]:
    """Tell of which of m rows all values are finite, (m,)."""
    widths = [math.prod(array.shape[1:]) for array in arrays]
    flat = [array.reshape(len(array), width) for array, width in zip(arrays, widths, strict=True)]
    columns = [column for array in flat for column in np.isfinite(array).T]  # faster than along rows of a few
    return np.asarray(np.logical_and.reduce(columns))


def _by_point(camera: pycolmap.Camera, xyz: Float64) -> Float64:
    """Return (m, 2, 3). A projection does not change along its ray, so two of three are measured."""
    step = _STEP * np.abs(xyz[:, 2])
    jacobian = np.zeros((len(xyz), 2, 3))
    for axis in range(2):
        ahead, behind = xyz.copy(), xyz.copy()
        ahead[:, axis] += step
        behind[:, axis] -= step
        moved = np.asarray(camera.img_from_cam(ahead)) - np.asarray(camera.img_from_cam(behind))
        jacobian[:, :, axis] = moved / (2 * step[:, None])
    along = jacobian[:, :, 0] * xyz[:, :1] + jacobian[:, :, 1] * xyz[:, 1:2]
    jacobian[:, :, 2] = -along / xyz[:, 2:]
    return jacobian


def _by_params(camera: pycolmap.Camera, xyz: Float64, at: Float64) -> Float64:
    """Return (m, 2, n). Every model of COLMAP's is a focal length times what is distorted, plus the principal point."""
    params = np.asarray(camera.params)
    jacobian = np.zeros((len(xyz), 2, len(params)))
    focal, centre = list(camera.focal_length_idxs()), list(camera.principal_point_idxs())
    for axis in range(2):
        along = focal[min(axis, len(focal) - 1)]
        jacobian[:, axis, along] = (at[:, axis] - params[centre[axis]]) / params[along]
        jacobian[:, axis, centre[axis]] = 1.0
    for index in camera.extra_params_idxs():
        step = np.zeros(len(params))
        step[index] = 10 * _STEP
        ahead = np.asarray(with_params(camera, params + step).img_from_cam(xyz))
        behind = np.asarray(with_params(camera, params - step).img_from_cam(xyz))
        jacobian[:, :, index] = (ahead - behind) / (2 * step[index])
    return jacobian


def tied(camera: pycolmap.Camera, free: Sequence[int]) -> Float64:
    """Return the basis (n, K) of the focal lengths, moved alike, and of the parameters `free`, each by itself."""
    columns = [list(camera.focal_length_idxs()), *([index] for index in free)]
    basis = np.zeros((len(camera.params), len(columns)))
    for number, indices in enumerate(columns):
        basis[indices, number] = 1.0
    return basis


def fitted(camera: pycolmap.Camera, model: str, coefficients: int, rounds: int = 8) -> pycolmap.Camera:
    """Return a camera of another model that shows what `camera` shows as nearly as it can, by least squares over the
    picture, where `camera` is certain of it: with the first so many coefficients of distortion, the others 0, and with
    the same principal point."""
    other = pycolmap.Camera.create_from_model_name(
        camera.camera_id, model, camera.mean_focal_length(), camera.width, camera.height
    )
    other.has_prior_focal_length = camera.has_prior_focal_length
    if camera.model == other.model:
        return with_params(other, np.asarray(camera.params))
    params = np.zeros(len(other.params))
    params[list(other.focal_length_idxs())] = camera.mean_focal_length()
    params[list(other.principal_point_idxs())] = camera.principal_point_x, camera.principal_point_y
    basis = tied(other, list(other.extra_params_idxs())[:coefficients])
    across, down = (np.linspace(0, side, 21) for side in (camera.width, camera.height))
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    rays = np.asarray(camera.cam_from_img(pixels), np.float64)
    seen = certain(camera, pixels)
    pixels, xyz = pixels[seen], np.concatenate([rays[seen], np.ones((int(seen.sum()), 1))], axis=1)
    for _ in range(rounds):
        now = with_params(other, params)
        at = np.asarray(now.img_from_cam(xyz))
        jacobian = _by_params(now, xyz, at) @ basis
        kept = _finite(at, jacobian)
        rows, off = jacobian[kept].reshape(-1, basis.shape[1]), (at - pixels)[kept].ravel()
        params = params - basis @ np.linalg.lstsq(rows, off, rcond=None)[0]
    return with_params(other, params)


def turned(free: FreeCamera, camera: pycolmap.Camera, quarter: int) -> FreeCamera:
    """Return the same lens for pictures of the size of `camera` that are turned by so many quarters: the principal
    point, seen from the middle, and coefficients that have a direction turn with them, and focal lengths across and
    down change places."""
    start = free.camera
    params = np.asarray(start.params).copy()
    centre, focal = list(start.principal_point_idxs()), list(start.focal_length_idxs())
    names = parameter_names(start)
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter % 4]
    turn = np.eye(len(params))
    vectors = [[names.index(name) for name in pair] for pair in _VECTORS if set(pair) <= set(names)]
    for pair in (centre, *vectors):
        turn[np.ix_(pair, pair)] = (cos, -sin), (sin, cos)
    if quarter % 2 and len(focal) == 2:
        turn[np.ix_(focal, focal)] = (0, 1), (1, 0)
    params[centre] -= np.array([start.width, start.height]) / 2
    params = turn @ params
    params[centre] += np.array([camera.width, camera.height]) / 2
    result = pycolmap.Camera.create_from_model_name(
        camera.camera_id, start.model_name, start.mean_focal_length(), camera.width, camera.height
    )
    result.has_prior_focal_length = camera.has_prior_focal_length
    return FreeCamera(with_params(result, params), turn @ free.basis)
