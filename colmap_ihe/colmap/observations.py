"""Hold what the photographs of a model see of it, as arrays: observations with their errors, and matches of two."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.calibration.block import Block, part_of
from colmap_ihe.colmap.native import pycolmap

Float64 = NDArray[np.float64]
Ints = NDArray[np.intp]
_CROSSING_PX = 4.0  # by which the rays of a match may miss each other: what COLMAP lets pass for a point
_LEAST_DEG = (
    1.5  # between the rays of a match: at less they say no depth, and COLMAP makes no point of them either
)
_Pair = tuple[int, int]


@dataclass(frozen=True)
class Observations:
    """Hold the `block` of a model with N images, `names` in its order, and of each of its M observations the
    reprojection error `errors_px` (M,), nan where a point is nowhere in the picture. `sizes` (N, 2): width and height;
    `focal_px` (N,): the mean focal length, nan of a panorama."""

    names: list[str]
    block: Block
    errors_px: Float64
    sizes: Float64
    focal_px: Float64

    @property
    def centres(self) -> Float64:
        """Return (N, 3): where the cameras stand."""
        return np.asarray(-np.einsum("nji,nj->ni", self.block.rotations, self.block.translations))

    @property
    def depths(self) -> Float64:
        """Return (M,): how far each observation's point lies before its camera, along the optical axis."""
        return np.asarray(self.block.in_camera()[:, 2])


def observations_of(model: pycolmap.Reconstruction) -> Observations:
    """Return what the registered images of a model see, in the order of their names."""
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: str(image.name))
    cameras = [model.cameras[image.camera_id] for image in images]
    block = part_of(model, [image.image_id for image in images], sorted(model.cameras)).block
    return Observations(
        [str(image.name) for image in images],
        block,
        _errors(block, cameras),
        np.array([(camera.width, camera.height) for camera in cameras], np.float64).reshape(-1, 2),
        np.array([np.nan if camera.is_spherical() else camera.mean_focal_length() for camera in cameras]),
    )


def _errors(block: Block, cameras: list[pycolmap.Camera]) -> Float64:
    """Return (M,): how far each observation is from where its camera has the point, in pixels."""
    places, errors = block.in_camera(), np.full(len(block.image), np.nan)
    for number, camera in enumerate(cameras):
        mine = np.flatnonzero(block.image == number)
        if len(mine):
            projected = np.asarray(camera.img_from_cam(places[mine])).reshape(-1, 2)
            errors[mine] = np.linalg.norm(block.pixels[mine] - projected, axis=1)
    return errors


def points_of_two(
    model: pycolmap.Reconstruction, database: Path, observations: Observations
) -> tuple[Float64, Ints]:
    """Return points (Q, 3) of verified matches that are no part of the model, and the two images (Q, 2) of each, by
    number. COLMAP leaves out points that only two images see, and where there are no others the model is empty."""
    found: list[Float64] = [np.zeros((0, 3))]
    numbers: list[Ints] = [np.zeros((0, 2), np.intp)]
    for pair, pixels in _matches_beside(database, observations).items():
        points = _crossings(model, observations, pair, pixels)
        found.append(points)
        numbers.append(np.tile(np.array(pair, np.intp), (len(points), 1)))
    return np.concatenate(found), np.concatenate(numbers)


def _matches_beside(database: Path, observations: Observations) -> dict[_Pair, tuple[Float64, Float64]]:
    """Return the pixels (n, 2) in both images of the verified matches of which neither end is a point of the model."""
    number_of = {name: number for number, name in enumerate(observations.names)}
    with pycolmap.Database.open(database) as opened:
        ids = {
            int(i.image_id): number_of[str(i.name)] for i in opened.read_all_images() if i.name in number_of
        }
        pairs, geometries = opened.read_two_view_geometries()
        keypoints = {
            n: np.asarray(opened.read_keypoints(i), np.float32)[:, :2].copy() for i, n in ids.items()
        }
    free = {number: ~_is_observed(observations.block, number, kept) for number, kept in keypoints.items()}
    beside = {}
    for pair, geometry in zip(pairs, geometries, strict=True):
        first, second = (ids.get(int(i), -1) for i in pycolmap.pair_id_to_image_pair(pair))
        matches = np.asarray(geometry.inlier_matches, np.intp).reshape(-1, 2)
        if first < 0 or second < 0 or not len(matches):
            continue
        matches = matches[free[first][matches[:, 0]] & free[second][matches[:, 1]]]
        one, other = keypoints[first][matches[:, 0]], keypoints[second][matches[:, 1]]
        beside[first, second] = (one.astype(np.float64), other.astype(np.float64))
    return beside


def _is_observed(block: Block, number: int, keypoints: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (K,) bool: the keypoints (K, 2) of an image that are observations of a point."""
    mine = np.ascontiguousarray(block.pixels[block.image == number], np.float32)
    return np.isin(keypoints.view(np.uint64).ravel(), mine.view(np.uint64).ravel())


def _crossings(
    model: pycolmap.Reconstruction,
    observations: Observations,
    pair: _Pair,
    pixels: tuple[Float64, Float64],
) -> Float64:
    """Return (n, 3): where the rays of matches come nearest to each other, of those that meet before both cameras."""
    rotations, centres = observations.block.rotations, observations.centres
    rays = []
    for number, places in zip(pair, pixels, strict=True):
        image = model.find_image_with_name(observations.names[number])
        ray = np.asarray(model.cameras[image.camera_id].cam_ray_from_img(places)).reshape(-1, 3)
        rays.append(ray / np.linalg.norm(ray, axis=1)[:, None] @ rotations[number])
    first, second = rays
    base = centres[pair[1]] - centres[pair[0]]
    cosine = (first * second).sum(axis=1)
    crossed = 1 - cosine**2
    wide = crossed > np.sin(np.radians(_LEAST_DEG)) ** 2
    first, second, cosine, crossed = first[wide], second[wide], cosine[wide], crossed[wide]
    along = (first @ base - cosine * (second @ base)) / crossed
    beyond = (cosine * (first @ base) - second @ base) / crossed
    ends = centres[pair[0]] + along[:, None] * first, centres[pair[1]] + beyond[:, None] * second
    gap = np.linalg.norm(ends[1] - ends[0], axis=1)
    a_pixel = 1 / np.nan_to_num(observations.focal_px[list(pair)], nan=1000.0).min()
    met = (along > 0) & (beyond > 0) & (gap < _CROSSING_PX * a_pixel * np.minimum(along, beyond))
    return np.asarray((ends[0] + ends[1])[met] / 2)
