"""Check whether photographs that were taken as by one camera are: by a focal length for each of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from colmap_ihe.colmap.calibration.adjust import adjust
from colmap_ihe.colmap.calibration.block import Block, Ints
from colmap_ihe.colmap.calibration.choose import A_PARAMETER, Fit
from colmap_ihe.colmap.calibration.equations import Prior, inverse_of, system_of
from colmap_ihe.colmap.calibration.lens import FreeCamera, derivatives, tied
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import SILENT, Progress

APART = 0.04
"""Between two focal lengths, from which on they are two settings of a zoom: focus moves one by less."""
_SURE = 4.0  # standard deviations
_LOOSE = 0.5  # standard deviation of a photograph's focal length from that of all, beforehand


@dataclass(frozen=True)
class FocalLength:
    """Hold the focal length of one image in pixels, with its standard deviation."""

    image: int
    pixels: float
    deviation: float


def focal_lengths(fit: Fit, camera: int, progress: Progress = SILENT) -> tuple[list[FocalLength], float]:
    """Return a focal length for each image of the block by the camera of this place in the fit's list, and by how much
    the cost falls with them free, in units of sigma squared beyond what chance does. Raises `Cancelled`."""
    block = fit.adjusted.block
    images = np.flatnonzero(block.cameras == camera)
    shared = fit.cameras[camera]
    alone, free = _each_its_own(block, fit.cameras, camera, images)
    prior = Prior(np.zeros(len(images)), np.full(len(images), _LOOSE * shared.mean_focal_length()))
    adjusted = adjust(alone, free, np.zeros(len(images)), prior, progress=progress)
    terms = derivatives(adjusted.block, free, adjusted.values)
    system = system_of(adjusted.block, terms, adjusted.sigma, prior, adjusted.values, 0.0)
    deviations = np.sqrt(np.diag(inverse_of(system)[-len(images) :]))
    found = [
        FocalLength(int(image), shared.mean_focal_length() + float(value), float(deviation))
        for image, value, deviation in zip(images, adjusted.values, deviations, strict=True)
    ]
    sigma = min(adjusted.sigma, fit.adjusted.sigma)
    return found, fit.adjusted.cost(sigma) - adjusted.cost(sigma) - A_PARAMETER * len(images)


def _each_its_own(
    block: Block, cameras: Sequence[pycolmap.Camera], camera: int, images: Ints
) -> tuple[Block, list[FreeCamera]]:
    """Return the block with a camera for each of these images, and all cameras: those with a focal length free."""
    count = len(images)
    free = [FreeCamera(one, np.zeros((len(one.params), count))) for one in cameras]
    numbers = block.cameras.copy()
    for column, image in enumerate(images):
        numbers[image] = len(free)
        basis = np.zeros((len(cameras[camera].params), count))
        basis[:, column] = tied(cameras[camera], [])[:, 0]
        free.append(FreeCamera(cameras[camera], basis))
    return replace(block, cameras=numbers), free


def groups_of(found: Sequence[FocalLength], gain: float) -> list[list[FocalLength]]:
    """Return the images in groups of one focal length each: one group, unless gaps between them are clear."""
    if gain <= 0:
        return [list(found)]
    ordered = sorted(found, key=lambda one: (one.pixels, one.image))
    groups = [[ordered[0]]]
    for before, one in itertools.pairwise(ordered):
        gap = one.pixels - before.pixels
        sure = _SURE * float(np.hypot(one.deviation, before.deviation))
        if gap > max(APART * before.pixels, sure):
            groups.append([])
        groups[-1].append(one)
    return groups
