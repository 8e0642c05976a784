"""A slanted wall of known colours, photographed through any of COLMAP's lenses, as a project with the true cameras.

Independent of COLMAP's lens models: points are projected by OpenCV's, and pictures are made by cutting the ray of
each pixel with the wall.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import planes
from PIL import Image

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Float64, PinholeCamera

SIZE = (320, 240)
OFF = (0.03 * SIZE[0], -0.03 * SIZE[0])
"""Of a principal point from the middle, in pixels: 3 % of the longer side, each way."""
_TEXELS = 40  # a unit: about a pixel of a fisheye of 120 degrees


def _wall() -> planes.Plane:
    """z = 4 + 0.15 x - 0.1 y, to 13 and 10 units from the middle, smooth enough to be sampled at any pixel."""
    noise = np.random.default_rng(5).normal(size=(20 * _TEXELS, 26 * _TEXELS))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.3) + 2 * cv2.GaussianBlur(noise, (0, 0), 5.0)
    texture = np.clip(128 + 45 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    return planes.Plane(
        np.array([0, 0, 4.0]), np.array([1, 0, 0.15]), np.array([0, 1, -0.1]), (13.0, 10.0), texture
    )


WALL = _wall()
POSES = {
    "a/1.png": planes.camera([-0.4, 0, 0], yaw_deg=4),
    "a/2.png": planes.camera([0, 0, 0]),
    "3.png": planes.camera([0.4, 0.05, 0], yaw_deg=-5),
    "4.png": planes.camera([0, 0.4, 0.1], roll_deg=80),
}


@dataclass(frozen=True)
class Lens:
    """A camera of COLMAP's `model`: focal lengths across and down and the principal point's offset from the middle in
    pixels, and the coefficients of distortion in COLMAP's order, which is OpenCV's."""

    model: str
    focal: tuple[float, float]
    distortion: tuple[float, ...] = ()
    off: tuple[float, float] = OFF

    def camera(self, camera_id: int) -> pycolmap.Camera:
        camera = pycolmap.Camera.create_from_model_name(camera_id, self.model, 1.0, *SIZE)
        focal = self.focal[: len(camera.focal_length_idxs())]
        camera.params = [*focal, *self._matrix()[:2, 2], *self.distortion]
        return camera

    def _matrix(self) -> Float64:
        x, y = SIZE[0] / 2 + self.off[0], SIZE[1] / 2 + self.off[1]
        return np.array([[self.focal[0], 0, x], [0, self.focal[1], y], [0, 0, 1]])

    def _coefficients(self) -> Float64:
        return np.array([*self.distortion, *[0.0] * (4 - len(self.distortion))], np.float64)

    @property
    def is_fisheye(self) -> bool:
        return self.model.endswith("FISHEYE")

    def pixels(self, in_camera: Float64) -> Float64:
        """(N, 2): where points (N, 3) before the camera are on the photograph."""
        project = cv2.fisheye.projectPoints if self.is_fisheye else cv2.projectPoints
        none = np.zeros(3)
        points = in_camera.reshape(-1, 1, 3)
        order = (points, none, none, self._matrix(), self._coefficients())
        return np.asarray(project(*order)[0], np.float64).reshape(-1, 2)

    def rays(self, pixels: Float64) -> Float64:
        """(N, 3), at depth one: what is seen at pixels (N, 2)."""
        undistort = cv2.fisheye.undistortPoints if self.is_fisheye else cv2.undistortPoints
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-10)
        points = pixels.reshape(-1, 1, 2).astype(np.float64)
        flat = undistort(points, self._matrix(), self._coefficients(), criteria=criteria)
        return np.column_stack([flat.reshape(-1, 2), np.ones(len(pixels))])


def fisheye(
    diagonal_deg: float, model: str = "OPENCV_FISHEYE", distortion: tuple[float, ...] = (0.0,) * 4
) -> Lens:
    """A fisheye lens that sees so many degrees from corner to corner, were it not off the middle and distorted."""
    focal = float(np.hypot(*SIZE) / np.radians(diagonal_deg))
    return Lens(model, (focal, focal), distortion)


def colour(points: Float64) -> Float64:
    """(N, 3): the colour of the wall at points (N, 3), which changes by up to 2 to 4 a pixel."""
    x, y, _ = points.T
    return np.asarray(128 + 100 * np.sin(np.stack([2 * x, 2 * y, 1.4 * (x + y)], axis=1)))


def wall_depth(view: PinholeCamera, rays: Float64) -> Float64:
    """(N,): how far along rays (N, 3) at depth one, in the frame of the camera, the wall is."""
    return np.asarray(((WALL.origin - view.centre) @ WALL.normal) / (rays @ view.rotation @ WALL.normal))


def seen(view: PinholeCamera, rays: Float64) -> tuple[Float64, Float64]:
    """The points of the wall (N, 3) that rays hit, and their grey values (N,), between texels by cubic splines."""
    points = (rays * wall_depth(view, rays)[:, None]) @ view.rotation + view.centre
    place = (((points - WALL.origin)[:, :2] + WALL.half) * _TEXELS - 0.5).astype(np.float32)
    parts = np.array_split(place, len(place) // 30_000 + 1)  # OpenCV takes no more than 32,766 rows
    x_and_y = [(np.ascontiguousarray(part[:, :1]), np.ascontiguousarray(part[:, 1:])) for part in parts]
    grey = [cv2.remap(WALL.texture_u8, x, y, cv2.INTER_CUBIC) for x, y in x_and_y]
    return points, np.concatenate(grey).ravel().astype(np.float64)


def centres(size: tuple[int, int]) -> Float64:
    """(W * H, 2): the centres of all pixels, row after row."""
    columns, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    return np.stack([columns.ravel(), rows.ravel()], axis=1)


@cache
def photograph_rays(lens: Lens) -> Float64:
    """(W * H, 3), at depth one: what is seen at the pixels of a photograph."""
    return lens.rays(centres(SIZE))


def make_project(root: Path, lenses: Mapping[str, Lens]) -> None:
    """sparse/, grey/ and colour/ below `root`: each photograph of `POSES` through the lens of its name."""
    for name, lens in lenses.items():
        points, grey = seen(POSES[name], photograph_rays(lens))
        for folder, values in (("grey", grey), ("colour", colour(points))):
            path = root / folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            pixels = np.clip(np.rint(values), 0, 255).astype(np.uint8)
            Image.fromarray(pixels.reshape(SIZE[1], SIZE[0], *values.shape[1:])).save(path)
    (root / "sparse").mkdir()
    model_of(lenses).write(root / "sparse")


def points_of_the_wall(count: int, seed: int = 3) -> Float64:
    """(N, 3), of which all photographs see many."""
    across = np.random.default_rng(seed).uniform((-6, -5), (6, 5), (count, 2))
    return np.asarray(WALL.origin + across[:, :1] * WALL.right + across[:, 1:] * WALL.down)


def in_camera(view: PinholeCamera, points: Float64) -> Float64:
    return np.asarray(points @ view.rotation.T + view.cam_from_world[:, 3])


def model_of(lenses: Mapping[str, Lens]) -> pycolmap.Reconstruction:
    """The wall, photographed from `POSES` through the lenses of these names, as a sparse model without an error."""
    model = pycolmap.Reconstruction()
    points = points_of_the_wall(1500)
    tracks = [pycolmap.Track() for _ in points]
    for number, (name, lens) in enumerate(lenses.items(), start=1):
        model.add_camera_with_trivial_rig(lens.camera(number))
        pixels = lens.pixels(in_camera(POSES[name], points))
        image = pycolmap.Image(name=name, keypoints=pixels, camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(POSES[name].cam_from_world))
        for row in np.flatnonzero(((pixels > 0) & (pixels < SIZE)).all(axis=1)):
            tracks[row].add_element(number, int(row))
    for point, track in zip(points, tracks, strict=True):
        if track.length() >= 2:
            model.add_point3D(point, track, np.zeros(3, np.uint8))
    return model
