"""Measure models and databases of COLMAP's."""

from __future__ import annotations

import shutil
from collections.abc import Container, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

_STRONGEST = 2000


def images_seeing(point: pycolmap.Point3D) -> int:
    """Count the images that see a point. Its track counts observations, and one image may have two of them."""
    return len({element.image_id for element in point.track.elements})


def poses_of(folder: Path) -> dict[str, NDArray[np.float64]]:
    """Return `cam_from_world`, (3, 4) float64, of every registered image of a model, by name."""
    model = pycolmap.Reconstruction(folder)
    images = [model.images[i] for i in model.reg_image_ids()]
    return {str(image.name): np.asarray(image.cam_from_world().matrix()) for image in images}


def cameras_of_images(database: Path) -> dict[str, int]:
    """Return the ids of the cameras of all images in a database, by the images' names."""
    with pycolmap.Database.open(database) as opened:
        return {str(image.name): int(image.camera_id) for image in opened.read_all_images()}


def has_turned_sizes(database: Path) -> bool:
    """Tell whether the height of one camera in a database is the width of another, and its width the other's height."""
    with pycolmap.Database.open(database) as opened:
        sizes = {(camera.width, camera.height) for camera in opened.read_all_cameras()}
    return any((height, width) in sizes for width, height in sizes if width > height)


def rms_px(folder: Path) -> float:
    """Return the root mean square of all reprojection errors of a model, in pixels; nan without points."""
    model = pycolmap.Reconstruction(folder)
    squared, count = 0.0, 0
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        observations = image.get_observation_points2D()
        if not observations:
            continue
        world = np.array([model.points3D[p.point3D_id].xyz for p in observations])
        projected = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * world)
        squares = ((np.array([p.xy for p in observations]) - projected) ** 2).sum(axis=1)
        squared += float(np.nansum(squares))
        count += int(np.isfinite(squares).sum())  # a point behind the camera is nowhere in its picture
    return (squared / count) ** 0.5 if count else float("nan")


def thin_out(database: Path, out: Path, share: float, seed: int) -> None:
    """Copy a database without a random `share` of each pair's verified matches."""
    shutil.copyfile(database, out)
    draw = np.random.default_rng(seed)
    with pycolmap.Database.open(out) as opened:
        for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            matches = np.asarray(geometry.inlier_matches)
            geometry.inlier_matches = matches[draw.random(len(matches)) >= share]
            opened.update_two_view_geometry(*pycolmap.pair_id_to_image_pair(pair), geometry)


def putative_and_inliers(database: Path) -> dict[tuple[str, str], tuple[int, int]]:
    """Return the numbers of putative and of verified matches of every pair that was matched, by names."""
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: str(image.name) for image in opened.read_all_images()}
        inliers = dict(zip(*opened.read_two_view_geometry_num_inliers(), strict=True))
        counts = {}
        for pair, count in zip(*opened.read_num_matches(), strict=True):
            first, second = (names[i] for i in pycolmap.pair_id_to_image_pair(pair))
            counts[first, second] = (int(count), int(inliers.get(pair, 0)))
    return counts


def strongest_pairs(
    opened: pycolmap.Database, least: int = 1
) -> Iterator[tuple[tuple[int, int], NDArray[np.intp]]]:
    """Yield ids and verified matches, (N, 2), of the pairs with most of them: at most 2,000, each with `least`."""
    counts = zip(*opened.read_two_view_geometry_num_inliers(), strict=True)
    pairs = sorted(((int(count), int(pair)) for pair, count in counts if count >= least), reverse=True)
    for _, pair in pairs[:_STRONGEST]:
        ids = pycolmap.pair_id_to_image_pair(pair)
        yield ids, np.asarray(opened.read_two_view_geometry(*ids).inlier_matches, np.intp).reshape(-1, 2)


def joined_by_matches(database: Path, least: int, names: Container[str] | None = None) -> int:
    """Count the images of the largest group that pairs of `least` verified matches or more join, of those in `names`
    if given."""
    with pycolmap.Database.open(database) as opened:
        images = {i.image_id for i in opened.read_all_images() if names is None or i.name in names}
        counts = zip(*opened.read_two_view_geometry_num_inliers(), strict=True)
        pairs = [pycolmap.pair_id_to_image_pair(pair) for pair, count in counts if count >= least]
    group_of = {image: {image} for image in images}
    for first, second in pairs:
        if first in images and second in images and group_of[first] is not group_of[second]:
            smaller, larger = sorted((group_of[first], group_of[second]), key=len)
            larger |= smaller
            group_of.update(dict.fromkeys(smaller, larger))
    return max(map(len, group_of.values()), default=0)


def upright(
    cam_from_world: Sequence[NDArray[np.float64]], up: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return the rotation, (3, 3) float64, that turns `up`, the mean upward direction of photographs, (3, 4) each, if
    None, to +y; what they look at is then towards -z."""
    up = -np.mean([pose[1, :3] for pose in cam_from_world], axis=0) if up is None else up
    back = -np.mean([pose[2, :3] for pose in cam_from_world], axis=0)
    right = np.cross(up, back)
    if np.linalg.norm(up) < 1e-6 or np.linalg.norm(right) < 1e-6:
        return np.eye(3)
    up, right = up / np.linalg.norm(up), right / np.linalg.norm(right)
    return np.stack((right, up, np.cross(right, up)))
