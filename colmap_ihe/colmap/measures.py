"""Numbers that are compared between models and databases of COLMAP's."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap


def poses_of(model: Path) -> dict[str, NDArray[np.float64]]:
    """(3, 4) `cam_from_world` of every registered image, by name."""
    found = pycolmap.Reconstruction(model)
    images = [found.images[i] for i in found.reg_image_ids()]
    return {str(image.name): np.asarray(image.cam_from_world().matrix()) for image in images}


def rms_px(model: Path) -> float:
    """The root mean square of all reprojection errors, in pixels; nan for a model without points."""
    found = pycolmap.Reconstruction(model)
    squared, count = 0.0, 0
    for image_id in found.reg_image_ids():
        image = found.images[image_id]
        seen = image.get_observation_points2D()
        if not seen:
            continue
        world = np.array([found.points3D[p.point3D_id].xyz for p in seen])
        camera = found.cameras[image.camera_id]
        projected = camera.img_from_cam(image.cam_from_world() * world)
        errors = np.array([p.xy for p in seen]) - projected
        squared += float(np.nansum(errors**2))
        count += len(seen)
    return (squared / count) ** 0.5 if count else float("nan")


def thin_out(database: Path, out: Path, share: float, seed: int) -> None:
    """A copy of a database without a random `share` of each pair's verified matches."""
    shutil.copyfile(database, out)
    draw = np.random.default_rng(seed)
    with pycolmap.Database.open(out) as opened:
        pairs, found = opened.read_two_view_geometries()
        for pair, geometry in zip(pairs, found, strict=True):
            matches = np.asarray(geometry.inlier_matches)
            geometry.inlier_matches = matches[draw.random(len(matches)) >= share]
            opened.update_two_view_geometry(*pycolmap.pair_id_to_image_pair(pair), geometry)


def putative_and_inliers(database: Path) -> dict[tuple[str, str], tuple[int, int]]:
    """Of every pair that was matched: putative matches, and how many of them its geometry verifies."""
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: str(image.name) for image in opened.read_all_images()}
        inliers = dict(zip(*opened.read_two_view_geometry_num_inliers(), strict=True))
        pairs, counts = opened.read_num_matches()
    found = {}
    for pair, count in zip(pairs, counts, strict=True):
        first, second = (names[i] for i in pycolmap.pair_id_to_image_pair(pair))
        found[first, second] = (int(count), int(inliers.get(pair, 0)))
    return found


def upright(cam_from_world: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """(3, 3): turns the mean upward direction of photographs, (3, 4) each, to +y; what they look at is towards -z."""
    up = -np.mean([pose[1, :3] for pose in cam_from_world], axis=0)
    back = -np.mean([pose[2, :3] for pose in cam_from_world], axis=0)
    right = np.cross(up, back)
    if np.linalg.norm(up) < 1e-6 or np.linalg.norm(right) < 1e-6:
        return np.eye(3)
    up, right = up / np.linalg.norm(up), right / np.linalg.norm(right)
    return np.stack((right, up, np.cross(right, up)))
