"""Tell how well the parameters of calibrated cameras are determined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from colmap_ihe.colmap.calibration.block import Float64
from colmap_ihe.colmap.calibration.choose import Fit
from colmap_ihe.colmap.calibration.equations import System, covariance, inverse_of, system_of
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens, freed
from colmap_ihe.colmap.calibration.lens import FreeCamera, derivatives
from colmap_ihe.colmap.native import parameter_names, pycolmap

DOUBTFUL = 0.95
"""Correlation of two parameters from which on one of them may stand for the other."""


@dataclass(frozen=True)
class Deviations:
    """Hold the standard deviations of a camera's parameters in COLMAP's order, 0 for what was held, and the pairs of
    parameters, one of them a focal length or of the principal point, that are correlated by more than `DOUBTFUL`, by
    name, with their correlation."""

    values: tuple[float, ...]
    correlated: tuple[tuple[str, str, float], ...]


def deviations_of(fit: Fit, known: Sequence[pycolmap.Camera]) -> list[Deviations]:
    """Return the deviations of all cameras of a fit, as far as they are free.

    A focal length and a principal point are as sure at the most as they are where all is free that a lens of the kind
    can have, within its priors: what the model chosen leaves out moves them too.
    """
    free, system = _system(fit, fit.lenses, known)
    own = covariance(fit.adjusted.block, system)
    rich = tuple(
        replace(lens, freedom=_considered(lens.freedom) if lens.freedom else None) for lens in fit.lenses
    )
    rich_free, system = _system(fit, rich, known)
    considered = inverse_of(system)[-system.by_free.shape[2] :]
    return [_of_camera(f, own, r, considered) for f, r in zip(free, rich_free, strict=True)]


def _considered(freedom: Freedom) -> Freedom:
    return replace(freedom.richest(), aspect=freedom.aspect)  # two focal lengths are rare, and hide both


def _system(
    fit: Fit, lenses: tuple[Lens, ...], known: Sequence[pycolmap.Camera]
) -> tuple[list[FreeCamera], System]:
    free, prior = freed(lenses, fit.cameras, known)
    values = np.zeros(len(prior.mean))
    terms = derivatives(fit.adjusted.block, free, values)
    return free, system_of(fit.adjusted.block, terms, fit.adjusted.sigma, prior, values, 0.0)


def _of_camera(free: FreeCamera, own: Float64, rich: FreeCamera, considered: Float64) -> Deviations:
    camera = free.camera
    matrix = free.basis @ own @ free.basis.T
    values = np.sqrt(np.maximum(np.diag(matrix), 0))
    for kind in ("focal_length_idxs", "principal_point_idxs"):
        here, there = list(getattr(camera, kind)()), list(getattr(rich.camera, kind)())
        for index, other in zip(here, there, strict=False):
            spread = float(np.sqrt(max(0.0, rich.basis[other] @ considered @ rich.basis[other])))
            values[index] = max(values[index], spread) if values[index] else 0.0
    names = parameter_names(camera)
    correlated = []
    telling = [*camera.focal_length_idxs(), *camera.principal_point_idxs()]
    for one, other in combinations(np.flatnonzero(np.diag(matrix) > 0), 2):
        if one not in telling and other not in telling:
            continue  # coefficients of distortion may well stand for one another
        value = matrix[one, other] / np.sqrt(matrix[one, one] * matrix[other, other])
        if DOUBTFUL < abs(value) < 1 - 1e-9:  # fx and fy that move alike are no doubt
            correlated.append((names[one], names[other], float(value)))
    return Deviations(tuple(values.tolist()), tuple(correlated))
