"""A wall with coded targets, photographed by a lens that bends lines, and the model of the photographs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.survey.targets import dictionary_of

SIZE = (480, 320)
_FINER = 3
_WALL_M = 3.0  # from the origin, along z
_SIDE_M = 0.25
_TEXELS = 400  # a metre
_CENTRES = {"a.png": -0.9, "b.png": -0.3, "c.png": 0.3, "north side/d.png": 0.9}

Targets = Iterable[tuple[int, tuple[float, float]]]
TARGETS = {3: (-0.6, -0.4), 8: (0.5, -0.3), 21: (0.0, 0.45)}
"""x and y in metres of the centre of each, by number."""


def true_point(number: int) -> NDArray[np.float64]:
    return np.array((*TARGETS[number], _WALL_M))


def lens() -> pycolmap.Camera:
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 420, *SIZE)
    camera.params = [420, 236, 163, -0.08]
    return camera


def wall_model() -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(lens())
    for image_id, (name, x) in enumerate(_CENTRES.items(), start=1):
        image = pycolmap.Image(name=name, camera_id=1, image_id=image_id)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(_pose(x)))
    return model


def write_photographs(folder: Path) -> None:
    """Grey pictures of all views."""
    for name in _CENTRES:
        write_photograph(folder, name, TARGETS.items())


def write_photograph(folder: Path, name: str, targets: Targets) -> None:
    """The grey picture of one view; a target may be there twice."""
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(_photograph(_wall(targets), _CENTRES[name])).save(file)


def _pose(x: float) -> NDArray[np.float64]:
    """(3, 4) cam_from_world of a camera at (x, 0, 0), turned towards the middle of the wall."""
    turn = np.asarray(cv2.Rodrigues(np.array((0, float(np.arctan2(x, _WALL_M)), 0)))[0])
    return np.column_stack((turn, -turn @ (x, 0, 0)))


def _wall(targets: Targets) -> NDArray[np.uint8]:
    """Square texture of 4 m around the axis."""
    wall = np.full((4 * _TEXELS, 4 * _TEXELS), 110, np.uint8)
    for number, (x, y) in targets:
        side = round(_SIDE_M * _TEXELS / 8) * 8
        margin = side // 4
        marker = cv2.aruco.generateImageMarker(dictionary_of("APRILTAG_36h11"), number, side)
        framed = np.pad(marker, margin, constant_values=255)
        top, left = (round((c + 2) * _TEXELS) - len(framed) // 2 for c in (y, x))
        wall[top : top + len(framed), left : left + len(framed)] = framed
    return np.asarray(40 + wall * 0.7, np.uint8)


def _photograph(wall: NDArray[np.uint8], x: float) -> NDArray[np.uint8]:
    rows, columns = np.mgrid[0 : SIZE[1] * _FINER, 0 : SIZE[0] * _FINER]
    pixels = (np.column_stack((columns.ravel(), rows.ravel())) + 0.5) / _FINER
    rays = np.column_stack((np.asarray(lens().cam_from_img(pixels)), np.ones(len(pixels)))) @ _pose(x)[:, :3]
    places = (rays[:, :2] * (_WALL_M / rays[:, 2:]) + (x, 0) + 2) * _TEXELS - 0.5
    local = places.reshape(*rows.shape, 2).astype(np.float32)
    fine = cv2.remap(wall, local[..., 0], local[..., 1], cv2.INTER_LINEAR, borderValue=(110,))
    seen = cv2.resize(np.asarray(fine, np.float32), SIZE, interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(3).normal(0, 1.5, seen.shape)
    return np.asarray(np.clip(np.rint(seen + noise), 0, 255), np.uint8)
