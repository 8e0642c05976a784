"""Read COLMAP's files of a project as plain arrays for a page: cloud, cameras, quality, matches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.field_of_view import certain_box, pixels_of
from colmap_ihe.colmap.measures import upright
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.observations import Observations, observations_of
from colmap_ihe.dense.ply import read_ply

_F32 = NDArray[np.float32]
_U8 = NDArray[np.uint8]
_F64 = NDArray[np.float64]

_RGB = ("red", "green", "blue")
_CELLS = 10  # a side, of the grid in which points cover a photograph
_GRID = 9  # places a side, between which a photograph is as good as undistorted
_FRUSTUM = 0.05  # of the size of the scene: how deep cameras are drawn


@dataclass(frozen=True)
class Points:
    """Hold shuffled `positions` (N, 3) in the frame of `ModelView`, `colours` (N, 3) uint8; `in_all` until thinned."""

    positions: _F32
    colours: _U8
    in_all: int


@dataclass(frozen=True)
class ImageCoverage:
    """Hold the points of one image, their mean reprojection error in pixels, and the share of its area they lie in."""

    points: int
    error_px: float | None
    coverage: float


@dataclass(frozen=True)
class CameraView:
    """Place a picture before its camera: `centre` (3,), `corners` (4, 3) from the top left clockwise.

    `box` (4,): left, top, right, bottom of the part between the corners, in shares of the picture. `grid` (G, G, 2):
    where a lattice of its pixels lies, in steps of the edges from the top left corner to the right and down; with a
    lens that does not distort (0, 0) to (1, 1) evenly. `size`: its width and height in pixels.
    """

    centre: _F32
    corners: _F32
    box: _F64
    grid: _F64
    size: tuple[int, int]


class ModelView:
    """Read a sparse model and turn it upright, its middle to the origin: y is up as the photographs were held, or what
    z is of a model in the frame of a survey (`z_is_up`). Raises what pycolmap raises where there is none."""

    def __init__(self, folder: Path, z_is_up: bool = False) -> None:
        self._model = pycolmap.Reconstruction(folder)
        self._by_name = {str(self._model.images[i].name): i for i in self._model.reg_image_ids()}
        self.names = sorted(self._by_name)
        self._xyz = np.array([p.xyz for p in self._model.points3D.values()]).reshape(-1, 3)
        poses = [self._model.images[i].cam_from_world().matrix() for i in self._by_name.values()]
        up = np.array((0.0, 0.0, 1.0)) if z_is_up else None
        self._rotation, self._middle, self._size = upright(poses, up), np.zeros(3), 1.0
        self.extent = np.zeros(3, np.float32)
        if len(self._xyz):
            low, high = np.percentile(self._xyz, (5, 95), axis=0)
            self._middle, self._size = np.median(self._xyz, axis=0), float(np.linalg.norm(high - low)) or 1.0
            self.extent = np.ptp(np.percentile(self.moved(self._xyz), (5, 95), axis=0), axis=0)

    @property
    def model(self) -> pycolmap.Reconstruction:
        """Return the model itself."""
        return self._model

    @cached_property
    def observations(self) -> Observations:
        """Return what the photographs see of it, as arrays."""
        return observations_of(self._model)

    @property
    def frame(self) -> tuple[_F64, _F64]:
        """Return rotation (3, 3) and middle (3,): a point of the model lies at rotation @ (point - middle) here."""
        return np.asarray(self._rotation, np.float64), np.asarray(self._middle, np.float64)

    def turned(self, directions: NDArray[np.floating]) -> _F32:
        """Return (N, 3) directions of the model, in this frame."""
        return np.asarray(directions @ self._rotation.T, np.float32)

    def moved(self, points: NDArray[np.floating]) -> _F32:
        """Return (N, 3) points of the model, in this frame."""
        return np.asarray((points - self._middle) @ self._rotation.T, np.float32)

    def _shuffled(self, points: NDArray[np.floating], colours: _U8, most: int, in_all: int) -> Points:
        order = np.random.default_rng(0).permutation(len(points))[:most]
        return Points(self.moved(points)[order], colours[order], in_all)

    def points(self, most: int) -> Points:
        """Return points of the model itself."""
        colours = np.array([p.color for p in self._model.points3D.values()], np.uint8).reshape(-1, 3)
        return self._shuffled(self._xyz, colours, most, len(self._xyz))

    def dense_points(self, cloud: Path, most: int) -> Points:
        """Return points of a fused cloud. Raises `ProjectError`."""
        rows = read_ply(cloud)["vertex"]
        some = rows[np.sort(np.random.default_rng(0).choice(len(rows), min(most, len(rows)), replace=False))]
        points, colours = (np.stack([some[name] for name in names], axis=1) for names in ("xyz", _RGB))
        return self._shuffled(points, colours, most, len(rows))

    def camera(self, name: str) -> CameraView:
        """Return where the picture of a photograph lies before its camera, each pixel on its ray. Of a picture that is
        too wide to be flat it is its middle."""
        image = self._model.images[self._by_name[name]]
        camera = self._model.cameras[image.camera_id]
        left, top, right, bottom = certain_box(camera)
        if camera.is_spherical():  # whose corners are all straight above and below
            left, top, right, bottom = np.array([3, 3, 5, 5]) / 8 * np.tile([camera.width, camera.height], 2)
        x, y = np.meshgrid(np.linspace(left, right, _GRID), np.linspace(top, bottom, _GRID))
        rays = np.asarray(camera.cam_ray_from_img(np.stack([x.ravel(), y.ravel()], axis=1)))
        flat = (rays / rays[:, 2:]).reshape(_GRID, _GRID, 3)
        corners = flat[(0, 0, -1, -1), (0, -1, -1, 0)]
        depth = _FRUSTUM * self._size / max(1.0, float(np.abs(corners[:, 0]).max()))
        world_from_cam = image.cam_from_world().inverse()
        box = np.array([left, top, right, bottom]) / np.tile([camera.width, camera.height], 2)
        return CameraView(
            self.moved(world_from_cam.translation),
            self.moved(world_from_cam * (corners * depth)),
            box,
            _between_corners(flat, corners),
            (camera.width, camera.height),
        )

    def seen(self, name: str) -> ImageCoverage:
        """Return what one image sees of the points."""
        seen = self.observations
        number = seen.names.index(name)
        mine = seen.block.image == number
        if not mine.any():
            return ImageCoverage(0, None, 0.0)
        cells = np.clip((seen.block.pixels[mine] / seen.sizes[number] * _CELLS).astype(int), 0, _CELLS - 1)
        coverage = len(np.unique(cells[:, 0] * _CELLS + cells[:, 1])) / _CELLS**2
        errors = seen.errors_px[mine]
        known = errors[np.isfinite(errors)]
        return ImageCoverage(int(mine.sum()), float(known.mean()) if len(known) else None, coverage)

    def points_by_images(self) -> Mapping[int, int]:
        """Count the points by the number of images that see them."""
        counts = np.bincount(np.bincount(self.observations.block.point))
        return {images: int(points) for images, points in enumerate(counts) if points}


def _between_corners(flat: _F64, corners: _F64) -> _F64:
    """Return (G, G, 2): places (G, G, 3) of the plane of the corners, in steps of their top and left edges."""
    sides = np.stack([corners[1] - corners[0], corners[3] - corners[0]], axis=1)[:2]
    return np.asarray((flat - corners[0])[..., :2] @ np.linalg.inv(sides).T)


def cloud_as_seen(cloud: Path, model: Path, name: str, longest: int) -> _U8:
    """Return (H, W, 3) uint8: a fused cloud as the camera of that image sees it, nearest points in front, white
    where there is none; the longer side is `longest` at the most. Raises `ProjectError`."""
    found = pycolmap.Reconstruction(model)
    image = next(i for i in found.images.values() if i.name == name)
    camera = found.cameras[image.camera_id]
    scale = min(1.0, longest / max(camera.width, camera.height))
    width, height = round(camera.width * scale), round(camera.height * scale)
    rows = read_ply(cloud)["vertex"]
    seen = image.cam_from_world() * np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
    rows, seen = rows[seen[:, 2] > 0], seen[seen[:, 2] > 0]
    places = pixels_of(camera, seen) * scale
    order = np.argsort(-seen[:, 2], kind="stable")
    order = order[np.isfinite(places[order, 0])]
    column, row = np.minimum(places[order].astype(np.intp), (width - 1, height - 1)).T
    drawn = np.full((height, width, 3), 255, np.uint8)
    drawn[row, column] = np.stack([rows[c][order] for c in _RGB], axis=1)
    return drawn


def places_of_matches(database: Path, first: str, second: str) -> tuple[_F64, _F64]:
    """Return (N, 2) each: where the verified matches of two images lie, in pixels."""
    with pycolmap.Database.open(database) as opened:
        ids = {str(image.name): image.image_id for image in opened.read_all_images()}
        geometry = opened.read_two_view_geometry(ids[first], ids[second])
        places = [np.asarray(opened.read_keypoints(ids[name]))[:, :2] for name in (first, second)]
    pairs = np.asarray(geometry.inlier_matches, np.intp).reshape(-1, 2)
    return places[0][pairs[:, 0]].astype(np.float64), places[1][pairs[:, 1]].astype(np.float64)


def verified_matches(database: Path, names: Sequence[str]) -> NDArray[np.int64]:
    """Return (n, n): how many inliers each two of the images share, in their order."""
    place = {name: n for n, name in enumerate(names)}
    found = np.zeros((len(names), len(names)), np.int64)
    with pycolmap.Database.open(database) as opened:
        of_id = {image.image_id: place.get(image.name) for image in opened.read_all_images()}
        pairs, counts = opened.read_two_view_geometry_num_inliers()
    for pair, count in zip(pairs, counts, strict=True):
        first, second = (of_id.get(i) for i in pycolmap.pair_id_to_image_pair(pair))
        if first is not None and second is not None:
            found[first, second] = found[second, first] = count
    return found
