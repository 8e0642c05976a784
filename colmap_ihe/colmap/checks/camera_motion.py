"""Tell from verified matches whether the camera moved sideways between photographs, so that depth shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.measures import strongest_pairs
from colmap_ihe.colmap.native import pycolmap

_F64 = NDArray[np.float64]

TURNED_DEGREES = 0.2
"""Matches that a turn on the spot explains to this angle, in the median, show no depth."""
_KNOWN, _GUESSED = np.geomspace(0.8, 1.25, 9), np.geomspace(0.5, 1.5, 17)  # factors of focal lengths to try
_SAMPLE = 400  # matches of a pair that are looked at
_LEAST = 3  # matches that fix a turn
_ROUNDS = 3  # of fitting a turn to those matches that the one before explains best


@dataclass(frozen=True)
class Motion:
    """Describe one verified pair: the names of its grey images, the number of its verified matches, and the median
    angle in degrees between rays to the same point, after the best turn and without any."""

    first: str
    second: str
    matches: int
    parallax: float
    turn: float

    @property
    def only_turned(self) -> bool:
        """Return whether a turn on the spot explains the matches."""
        return self.parallax < TURNED_DEGREES


def motions_of(database: Path) -> list[Motion]:
    """Return the motion of the verified pairs with most matches, at most 2,000 of them."""
    with pycolmap.Database.open(database) as opened:
        images = {image.image_id: image for image in opened.read_all_images()}
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        motions = []
        for ids, matches in strongest_pairs(opened):
            sample = matches[:: -(-len(matches) // _SAMPLE)]
            first, second = (
                np.asarray(opened.read_keypoints(i), np.float64)[sample[:, n], :2] for n, i in enumerate(ids)
            )
            one, other = (images[i] for i in ids)
            angles = parallax_of(first, second, cameras[one.camera_id], cameras[other.camera_id])
            motions.append(Motion(str(one.name), str(other.name), len(matches), *angles))
        return motions


def parallax_of(
    first: _F64, second: _F64, camera: pycolmap.Camera, other: pycolmap.Camera
) -> tuple[float, float]:
    """Return median angles in degrees between the rays to matched points, (N, 2) pixels each: after the best turn, and
    without any; 180 where the cameras tell no rays. The focal lengths are part of the fit, within what may be known of
    them."""
    have_priors = camera.has_prior_focal_length and other.has_prior_focal_length
    fits = []
    for factor in _KNOWN if have_priors else _GUESSED:
        ones, others = _directions(first, camera, factor), _directions(second, other, factor)
        told = np.isfinite(ones).all(axis=1) & np.isfinite(others).all(axis=1)
        if np.count_nonzero(told) < _LEAST:  # a model that turns back has no rays for pixels far out
            continue
        ones, others = ones[told], others[told]
        # a longer lens makes all angles small
        fits.append((factor * _after_turn(ones, others), factor * float(np.median(_angles(ones, others)))))
    return min(fits, key=lambda fit: fit[0], default=(180.0, 180.0))


def _directions(points: _F64, camera: pycolmap.Camera, factor: float) -> _F64:
    """Return the rays to pixels (N, 2), by the model of the camera with its focal lengths times `factor`."""
    params = camera.params.copy()
    params[list(camera.focal_length_idxs())] *= factor
    tried = pycolmap.Camera({**camera.todict(), "params": params})
    return np.asarray(tried.cam_ray_from_img(points))


def _after_turn(ones: _F64, others: _F64) -> float:
    """Return the median angle after the turn of one bundle of rays to the other (Kabsch), fitted to the better half."""
    kept = np.arange(len(ones))
    angles = np.zeros(len(ones))
    for _ in range(_ROUNDS):
        u, _, vt = np.linalg.svd(others[kept].T @ ones[kept])
        turn = u @ np.diag((1, 1, np.linalg.det(u @ vt))) @ vt
        angles = _angles(ones @ turn.T, others)
        kept = np.argsort(angles, kind="stable")[: max(3, len(ones) // 2)]
    return float(np.median(angles))


def _angles(ones: _F64, others: _F64) -> _F64:
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(ones - others, axis=1) / 2, 0, 1))))
