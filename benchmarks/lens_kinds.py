"""Draw cameras with lenses of a kind, and what COLMAP knows of them when it begins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from lens_features import ray_angles
from lens_scenes import View

from colmap_ihe.colmap.native import pycolmap

Parameters = tuple[float, ...]
Draw = Callable[[np.random.Generator], Parameters]


@dataclass(frozen=True)
class Lens:
    """Describe a kind of lens: COLMAP's model, the range of focal lengths in longer sides, and what draws the rest."""

    model: str
    focal: tuple[float, float]
    distortion: Draw


def _ranges(*ranges: tuple[float, float]) -> Draw:
    return lambda rng: tuple(float(rng.uniform(low, high)) for low, high in ranges)


def _decentred(rng: np.random.Generator) -> Parameters:
    k1, k2, size, way = rng.uniform((-0.12, 0, 0.7e-3, 0), (-0.04, 0.04, 1.5e-3, 2 * np.pi)).tolist()
    return k1, k2, float(size * np.cos(way)), float(size * np.sin(way))


def _moustache(rng: np.random.Generator) -> Parameters:
    k1, k2, k3 = rng.uniform((-0.14, 0.12, -0.06), (-0.10, 0.18, -0.02)).tolist()
    return k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0


_USUAL = (0.75, 1.4)
LENSES: Mapping[str, Lens] = {
    "none": Lens("SIMPLE_PINHOLE", _USUAL, _ranges()),
    "barrel": Lens("SIMPLE_RADIAL", _USUAL, _ranges((-0.15, -0.05))),
    "barrel2": Lens("RADIAL", _USUAL, _ranges((-0.15, -0.05), (0.01, 0.06))),
    "pincushion": Lens("SIMPLE_RADIAL", _USUAL, _ranges((0.03, 0.08))),
    "decentred": Lens("OPENCV", _USUAL, _decentred),
    "complex": Lens("FULL_OPENCV", _USUAL, _moustache),
    "fisheye": Lens(
        "OPENCV_FISHEYE",
        (0.53, 0.69),
        _ranges((-0.03, 0.03), (-0.01, 0.01), (-0.004, 0.004), (-0.001, 0.001)),
    ),
    "strong": Lens("RADIAL", (0.5, 0.7), _ranges((-0.32, -0.27), (0.09, 0.11))),
}
"""By name. A name with "+1" behind it has its principal point 1 % of the longer side off the middle."""


def true_camera(lens: str, size: tuple[int, int], rng: np.random.Generator) -> pycolmap.Camera:
    """Draw a camera of a kind of lens. ValueError where the lens is unknown or folds within the picture."""
    name, _, per_cent = lens.partition("+")
    if name not in LENSES:
        raise ValueError(
            f"lens {lens!r} is not known: take one of {', '.join(LENSES)}, with +1 behind it for 1 % off"
        )
    kind, longer = LENSES[name], max(size)
    focal, way, off = rng.uniform((kind.focal[0], 0, 0), (kind.focal[1], 2 * np.pi, 2)).tolist()
    distortion = kind.distortion(rng)
    shift = (float(per_cent) if per_cent else off) / 100 * longer
    middle = (size[0] / 2 + shift * np.cos(way), size[1] / 2 + shift * np.sin(way))
    single = kind.model.startswith("SIMPLE") or kind.model == "RADIAL"
    lengths = (focal * longer,) if single else (focal * longer, focal * longer)
    camera = pycolmap.Camera(
        model=kind.model, width=size[0], height=size[1], params=[*lengths, *middle, *distortion], camera_id=1
    )
    farthest = (0 if middle[0] > size[0] / 2 else size[0], 0 if middle[1] > size[1] / 2 else size[1])
    angles = ray_angles(camera, np.linspace(farthest, middle, 400))
    if not (np.diff(angles) < 0).all():
        raise ValueError(f"lens {lens} folds within the picture: {camera.params_to_string()}")
    return camera


def view_of(camera: pycolmap.Camera) -> View:
    """Return the half angles of a camera's photographs, as if its principal point were in the middle."""
    middle = np.array([camera.principal_point_x, camera.principal_point_y])
    half = np.diag([camera.width / 2, camera.height / 2])
    side, top = ray_angles(camera, middle + half).tolist()
    return View(side, top)


def start_camera(truth: pycolmap.Camera, prior_focal: bool, rng: np.random.Generator) -> pycolmap.Camera:
    """Return the camera that COLMAP begins with: SIMPLE_RADIAL, its focal length from EXIF or guessed."""
    longer = max(truth.width, truth.height)
    focal = truth.mean_focal_length() * rng.uniform(0.985, 1.015) if prior_focal else 1.2 * longer
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", focal, truth.width, truth.height)
    camera.has_prior_focal_length = prior_focal
    return camera
