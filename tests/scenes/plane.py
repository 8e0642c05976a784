"""A small dense workspace with known truth: a slanted plane in a few views with awkward names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.colmap.native import pycolmap

Centre = tuple[float, float, float]

VIEWS: Mapping[str, Centre] = {
    "façade 1.png": (-0.8, 0, 0),
    "nef/a.png": (-0.4, 0, 0),
    "nef/b c.png": (0, 0, 0),
    "nef/côté/d.png": (0.4, 0, 0),
    "e.png": (0, 0.4, 0),
}
SIZE = (320, 240)
K = np.array([[340.0, 0, 160], [0, 340, 120], [0, 0, 1]])
# The plane n.X = d through (0, 0, 4).
NORMAL = np.array([0.2, -0.1, -1]) / np.linalg.norm([0.2, -0.1, -1])
COLOUR = (0.9, 0.6, 0.3)
_TEXELS = 90  # a unit of x or y


def plane_depth(centre: Centre) -> NDArray[np.float64]:
    v, u = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T
    return np.asarray(((np.array([0, 0, 4]) - centre) @ NORMAL) / (rays @ NORMAL))


def make_project(root: Path, views: Mapping[str, Centre] = VIEWS) -> None:
    """sparse/, grey/ and colour/ below `root`, of views along x."""
    left = min(x for x, _, _ in views.values()) - 4
    right = max(x for x, _, _ in views.values()) + 4
    noise = np.random.default_rng(2).normal(size=(600, int((right - left) * _TEXELS)))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    texture = np.clip(128 + 45 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    for name, centre in views.items():
        grey = _photograph(centre, texture, left)
        colour = (grey[..., None] * np.array(COLOUR)).astype(np.uint8)
        for folder, pixels in (("grey", grey), ("colour", colour)):
            path = root / folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(pixels).save(path)
    (root / "sparse").mkdir()
    _model(views).write(root / "sparse")


def _photograph(centre: Centre, texture: NDArray[np.uint8], left: float) -> NDArray[np.uint8]:
    """The plane's texture, fixed to the world's x and y, through the view's own rays."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    depth = plane_depth(centre)
    x = (u - K[0, 2]) / K[0, 0] * depth + centre[0]
    y = (v - K[1, 2]) / K[1, 1] * depth + centre[1]
    place = (((x - left) * _TEXELS).astype(np.float32), (y * _TEXELS + 300).astype(np.float32))
    return np.asarray(cv2.remap(texture, *place, cv2.INTER_CUBIC), np.uint8)


def _model(views: Mapping[str, Centre]) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 340, *SIZE)
    camera.params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    model.add_camera_with_trivial_rig(camera)
    along = [x for x, _, _ in views.values()]
    count = int(150 * (max(along) - min(along) + 1.4) / 3)
    points = np.random.default_rng(3).uniform([min(along) - 0.7, -1, 0], [max(along) + 1.1, 1, 0], (count, 3))
    points[:, 2] = 4 - (points[:, :2] @ NORMAL[:2]) / NORMAL[2]
    tracks = [pycolmap.Track() for _ in points]
    for image_id, (name, centre) in enumerate(views.items(), start=1):
        pixels = (points - centre) @ K.T
        flat = pixels[:, :2] / pixels[:, 2:]
        image = pycolmap.Image(name=name, keypoints=flat, camera_id=1, image_id=image_id)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), -np.array(centre, float))
        model.add_image_with_trivial_frame(image, pose)
        for index, (x, y) in enumerate(flat):
            if 0 < x < SIZE[0] and 0 < y < SIZE[1]:
                tracks[index].add_element(image_id, index)
    for point, track in zip(points, tracks, strict=True):
        if track.length() >= 2:
            model.add_point3D(point, track, np.zeros(3, np.uint8))
    return model
