"""Describe a model by what real cameras and scenes limit: focal lengths, the shape of pixels, flatness."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.measures import images_seeing
from colmap_ihe.colmap.native import pycolmap

FLAT = 0.01
"""Thickness of the scene, in its extent, below which it is a plane to its cameras."""
_MOST = 95  # per cent of the points that count for the thickness
_LEAST_POINTS = 30


@dataclass(frozen=True)
class SolvedCamera:
    """Describe one camera of a model. `images`: names of its registered grey images. Focal lengths in pixels: `prior`
    of EXIF, None without; `focal`, the solved one. `aspect`: the solved one across over that down."""

    images: tuple[str, ...]
    prior: float | None
    focal: float
    aspect: float


def cameras_of(folder: Path, database: Path) -> list[SolvedCamera]:
    """Return the cameras of the model in `folder` that have a focal length, that of most images first."""
    model = pycolmap.Reconstruction(folder)
    with pycolmap.Database.open(database) as opened:
        cameras_before = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        before = {str(i.name): cameras_before[i.camera_id] for i in opened.read_all_images()}
    names: dict[int, list[str]] = defaultdict(list)
    for number in model.reg_image_ids():
        names[model.images[number].camera_id].append(str(model.images[number].name))
    cameras = []
    for number, images in sorted(names.items(), key=lambda n: (-len(n[1]), n[0])):
        camera, prior = model.cameras[number], before[images[0]]
        if camera.is_spherical():  # a panorama has no focal length, and COLMAP dies when asked for it
            continue
        known = prior.mean_focal_length() if prior.has_prior_focal_length else None
        aspect = camera.focal_length_x / camera.focal_length_y
        cameras.append(SolvedCamera(tuple(sorted(images)), known, camera.mean_focal_length(), aspect))
    return cameras


@dataclass(frozen=True)
class Shape:
    """Describe the shape of a model. `thickness`: the distance of its points from the plane nearest to them, over their
    extent; 1 for too few points to tell. `turned`: the most degrees between the views of two photographs."""

    thickness: float
    turned: float


def shape_of(folder: Path) -> Shape:
    """Return the shape of the model in `folder`."""
    model = pycolmap.Reconstruction(folder)
    places = [p.xyz for p in model.points3D.values() if images_seeing(p) > 2]
    xyz = np.array(places, np.float64).reshape(-1, 3)
    axes = np.array([model.images[i].cam_from_world().rotation.matrix()[2] for i in model.reg_image_ids()])
    mean = axes.mean(axis=0)
    # Twice the widest from the mean: exact for a fan, and does not grow with the square of the photographs.
    away = np.degrees(np.arccos(np.clip(axes @ mean / max(1e-9, float(np.linalg.norm(mean))), -1, 1)))
    return Shape(thickness(xyz), 2 * float(away.max()))


def thickness(xyz: NDArray[np.float64]) -> float:
    """Return `thickness` of `Shape` for (N, 3) points: the plane is fitted again to those near it, without strays."""
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
