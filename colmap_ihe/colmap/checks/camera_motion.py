"""How the camera moved between photographs, by their verified matches: sideways, so that depth shows, or not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

_F64 = NDArray[np.float64]

TURNED_DEGREES = 0.2
"""Matches that a turn on the spot explains to this angle, in the median, show no depth."""
_KNOWN, _GUESSED = (
    np.geomspace(0.8, 1.25, 9),
    np.geomspace(0.5, 1.5, 17),
)  # factors of focal lengths that are tried
_SAMPLE = 400  # matches of a pair that are looked at
_ROUNDS = 3  # of fitting a turn to those matches that the one before explains best
_PAIRS = 2000


@dataclass(frozen=True)
class Motion:
    """Of one verified pair: the names of its grey images, its verified matches, the median angle in degrees between
    rays to the same point that is left after the best turn, and that which is there without any."""

    first: str
    second: str
    matches: int
    parallax: float
    turn: float

    @property
    def only_turned(self) -> bool:
        return self.parallax < TURNED_DEGREES


def motions_of(database: Path) -> list[Motion]:
    """Of the verified pairs with most matches, at most 2,000 of them."""
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: (str(image.name), image.camera_id) for image in opened.read_all_images()}
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        counts = zip(*opened.read_two_view_geometry_num_inliers(), strict=True)
        chosen = sorted(((int(n), int(pair)) for pair, n in counts if n), reverse=True)[:_PAIRS]
        return [_motion(opened, pair, names, cameras) for _, pair in chosen]


def _motion(
    opened: pycolmap.Database,
    pair: int,
    names: dict[int, tuple[str, int]],
    cameras: dict[int, pycolmap.Camera],
) -> Motion:
    ids = pycolmap.pair_id_to_image_pair(pair)
    matches = np.asarray(opened.read_two_view_geometry(*ids).inlier_matches, np.intp).reshape(-1, 2)
    some = matches[:: -(-len(matches) // _SAMPLE)]
    places = [np.asarray(opened.read_keypoints(i), np.float64)[some[:, n], :2] for n, i in enumerate(ids)]
    one, other = (cameras[names[i][1]] for i in ids)
    parallax, turn = parallax_of(places[0], places[1], one, other)
    return Motion(names[ids[0]][0], names[ids[1]][0], len(matches), parallax, turn)


def parallax_of(
    first: _F64, second: _F64, camera: pycolmap.Camera, other: pycolmap.Camera
) -> tuple[float, float]:
    """Median angles in degrees between the rays to matched places, (N, 2) pixels each: after the best turn, and
    without any, at the cameras' focal lengths. Those are part of the fit, within what may be known of them."""
    known = camera.has_prior_focal_length and other.has_prior_focal_length
    found = [
        (factor * _after_turn(ones, others), factor, ones, others)  # a longer lens makes all angles small
        for factor, ones, others in _rays(first, second, camera, other, _KNOWN if known else _GUESSED)
    ]
    parallax, factor, ones, others = min(found, key=lambda f: f[0])
    return parallax, factor * float(np.median(_angles(ones, others)))


def _rays(
    first: _F64, second: _F64, camera: pycolmap.Camera, other: pycolmap.Camera, factors: _F64
) -> Iterator[tuple[float, _F64, _F64]]:
    for factor in factors:
        yield factor, _directions(first, camera, factor), _directions(second, other, factor)


def _directions(places: _F64, camera: pycolmap.Camera, factor: float) -> _F64:
    middle = (camera.principal_point_x, camera.principal_point_y)
    rays = np.column_stack([(places - middle) / (factor * camera.mean_focal_length()), np.ones(len(places))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _after_turn(ones: _F64, others: _F64) -> float:
    """The median angle after the turn that brings one bundle of rays nearest to the other (Kabsch), fitted again to
    the better half."""
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
