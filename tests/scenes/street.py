"""A street walked forward: two rows of facades and a camera that moves along its axis, as a database of COLMAP's.

Keypoints and matches are computed, so that neither photographs nor features are needed; COLMAP verifies the matches.
World in metres: x to the right, y down, z along the street. Frames are in COLMAP's pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

F64 = NDArray[np.float64]

WIDTH, HEIGHT = 1200, 800
FOCAL_PX = 900.0
_HEIGHT_M, _EYE_M = 7.0, 1.6  # of the facades, and of the camera above the ground
_NEAR_M, _FAR_M = 1.5, 25.0
_SEEN_AGAIN = 0.6  # of the points before the camera, those that give a feature


@dataclass(frozen=True)
class Street:
    """A walk of so many `images`, `step` metres from one to the next; `points` on both facades, each `half_width` from
    the axis. The camera wanders by `wander` metres and `turn` degrees (standard deviations). A point is matched where
    its scale and the direction to it differ by at most `scale` and `angle` degrees; a share of `outliers` is wrong."""

    images: int = 10
    step: float = 1.5
    points: int = 3000
    half_width: float = 4.0
    wander: float = 0.15
    turn: float = 3.0
    scale: float = 2.0
    angle: float = 20.0
    noise_px: float = 0.5
    outliers: float = 0.05
    seed: int = 1
    sideways: bool = False


@dataclass(frozen=True)
class _View:
    centre: F64
    seen: NDArray[np.intp]
    places: NDArray[np.float32]


def write_street(street: Street, database: Path) -> F64:
    """Write the database, whose one camera guesses its focal length as COLMAP does, and return the true centres of the
    camera, (N, 3). The grey images have the names `name_of(0)` and up."""
    draw = np.random.default_rng(street.seed)
    points = _facades(street, draw)
    views = [_view(street, points, number, draw) for number in range(street.images)]
    with pycolmap.Database.open(database) as opened:
        ids = _write_images(opened, views)
        for one, other in combinations(range(street.images), 2):
            matches = _matches(street, points, views[one], views[other], draw)
            if len(matches) >= 15:
                _write_pair(opened, (ids[one], ids[other]), (views[one], views[other]), matches)
    return np.array([view.centre for view in views])


def name_of(number: int) -> str:
    return f"{number:02}.png"


def write_blank_images(street: Street, folder: Path) -> None:
    """Write grey images of the names in the database, for what only asks that they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(street.images):
        header = f"P5\n{WIDTH} {HEIGHT}\n255\n".encode()
        (folder / name_of(number)).write_bytes(header + bytes(WIDTH * HEIGHT))


def position_error(model: pycolmap.Reconstruction, centres: F64) -> float:
    """Return the largest distance in metres of a camera from its true place, after the best similarity."""
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: str(image.name))
    found = np.array([image.projection_center() for image in images])
    true = centres[[int(image.name[:2]) for image in images]]
    found, true = found - found.mean(axis=0), true - true.mean(axis=0)
    u, sizes, vt = np.linalg.svd(true.T @ found)
    mirror = np.array([1, 1, np.linalg.det(u @ vt)])
    scale = (sizes * mirror).sum() / (found**2).sum()
    aligned = scale * found @ (u * mirror @ vt).T
    return float(np.linalg.norm(aligned - true, axis=1).max())


def _facades(street: Street, draw: np.random.Generator) -> F64:
    count = street.points
    side = np.where(draw.random(count) < 0.5, -1, 1)
    across = side * (street.half_width + draw.uniform(-0.6, 0.3, count))
    down = _EYE_M - draw.uniform(0, _HEIGHT_M, count)
    along = draw.uniform(0, street.images * street.step + _FAR_M, count)
    if street.sideways:  # one facade, before a camera that walks along it
        return np.stack([along - _FAR_M / 2, down, np.abs(across) + 2], axis=1)
    return np.stack([across, down, along], axis=1)


def _view(street: Street, points: F64, number: int, draw: np.random.Generator) -> _View:
    centre = draw.normal(0, street.wander, 3) * [1, 0.5, 0]
    centre[0 if street.sideways else 2] += number * street.step
    rays = (points - centre) @ _turn(*np.radians(draw.normal(0, street.turn, 3)))
    places = rays[:, :2] / rays[:, 2:] * FOCAL_PX + (WIDTH / 2, HEIGHT / 2)
    is_seen = (rays[:, 2] > _NEAR_M) & (rays[:, 2] < _FAR_M) & (draw.random(len(points)) < _SEEN_AGAIN)
    is_seen &= (places > 0).all(axis=1) & (places < (WIDTH, HEIGHT)).all(axis=1)
    seen = np.flatnonzero(is_seen)
    noisy = places[seen] + draw.normal(0, street.noise_px, (len(seen), 2))
    return _View(centre, seen, noisy.astype(np.float32))


def _turn(yaw: float, pitch: float, roll: float) -> F64:
    c, s = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    about_y = np.array([[c[0], 0, s[0]], [0, 1, 0], [-s[0], 0, c[0]]])
    about_x = np.array([[1, 0, 0], [0, c[1], -s[1]], [0, s[1], c[1]]])
    about_z = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    return np.asarray(about_y @ about_x @ about_z)


def _matches(
    street: Street, points: F64, one: _View, other: _View, draw: np.random.Generator
) -> NDArray[np.uint32]:
    both = np.intersect1d(one.seen, other.seen)
    near, far = points[both] - one.centre, points[both] - other.centre
    lengths = np.linalg.norm(near, axis=1), np.linalg.norm(far, axis=1)
    angle = np.degrees(np.arccos(np.clip((near * far).sum(axis=1) / (lengths[0] * lengths[1]), -1, 1)))
    scale = np.maximum(lengths[0] / lengths[1], lengths[1] / lengths[0])
    both = both[(angle < street.angle) & (scale < street.scale)]
    pairs = np.stack([np.searchsorted(one.seen, both), np.searchsorted(other.seen, both)], axis=1)
    wrong = draw.choice(len(pairs), int(street.outliers * len(pairs)), replace=False)
    pairs[wrong, 1] = draw.integers(0, len(other.seen), len(wrong))
    return np.asarray(pairs[np.unique(pairs[:, 1], return_index=True)[1]], np.uint32)


def _write_images(opened: pycolmap.Database, views: list[_View]) -> list[int]:
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 1.2 * WIDTH, WIDTH, HEIGHT)
    camera_id = opened.write_camera(camera)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id))
    rig_id, ids = opened.write_rig(rig), []
    for number, view in enumerate(views):
        ids.append(opened.write_image(pycolmap.Image(name=name_of(number), camera_id=camera_id)))
        opened.write_keypoints(ids[-1], view.places)
        frame = pycolmap.Frame()
        frame.rig_id = rig_id
        frame.add_data_id(opened.read_image(ids[-1]).data_id)
        opened.write_frame(frame)
    return ids


def _write_pair(
    opened: pycolmap.Database, ids: tuple[int, int], views: tuple[_View, _View], matches: NDArray[np.uint32]
) -> None:
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = 0
    (camera,) = opened.read_all_cameras()
    first, second = (view.places.astype(np.float64) for view in views)
    geometry = pycolmap.estimate_two_view_geometry(camera, first, camera, second, matches, options)
    opened.write_matches(*ids, matches)
    opened.write_two_view_geometry(*ids, geometry)
