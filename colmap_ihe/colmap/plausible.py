"""Whether a model is one that real cameras and a real scene give: focal lengths, the shape of pixels, flatness."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

FLAT = 0.01
"""Thickness of the scene, in its extent, below which it is a plane to its cameras."""
_MOST = 95  # per cent of the points that count for the thickness
_LEAST_POINTS = 30


@dataclass(frozen=True)
class Taken:
    """One camera of a model. `images`: the names of its grey images that have a place. `prior`: the focal length that
    the photographs said, None if they did not; `focal`: that which was found, `aspect`: that across over that down;
    in pixels."""

    images: tuple[str, ...]
    prior: float | None
    focal: float
    aspect: float


def cameras_of(folder: Path, database: Path) -> list[Taken]:
    """The cameras of the model in `folder`, that of most images first."""
    model = pycolmap.Reconstruction(folder)
    with pycolmap.Database.open(database) as opened:
        before = {camera.camera_id: camera for camera in opened.read_all_cameras()}
    names: dict[int, list[str]] = defaultdict(list)
    for number in model.reg_image_ids():
        names[model.images[number].camera_id].append(str(model.images[number].name))
    found = []
    for number, some in sorted(names.items(), key=lambda n: (-len(n[1]), n[0])):
        camera, was = model.cameras[number], before[number]
        found.append(
            Taken(
                tuple(sorted(some)),
                was.mean_focal_length() if was.has_prior_focal_length else None,
                camera.mean_focal_length(),
                camera.focal_length_x / camera.focal_length_y,
            )
        )
    return found


def thickness_of(folder: Path) -> float:
    """How far the points of the model in `folder` lie from the plane nearest to them, over their extent in it; 1 for
    too few points to tell."""
    model = pycolmap.Reconstruction(folder)
    xyz = np.array([p.xyz for p in model.points3D.values() if p.track.length() > 2], np.float64).reshape(
        -1, 3
    )
    return thickness(xyz)


def thickness(xyz: NDArray[np.float64]) -> float:
    """Of (N, 3) points: the plane is fitted again to those near it, and strays do not count."""
    if len(xyz) < _LEAST_POINTS:
        return 1.0
    kept = xyz
    for _ in range(3):
        middle = np.median(kept, axis=0)
        normal = np.linalg.svd(kept - middle, full_matrices=False)[2][2]
        away = np.abs((xyz - middle) @ normal)
        kept = xyz[away <= np.percentile(away, _MOST)]
    low, high = np.percentile(xyz, (5, 95), axis=0)
    extent = float(np.linalg.norm(high - low))
    return float(np.percentile(away, _MOST)) / extent if extent else 1.0
