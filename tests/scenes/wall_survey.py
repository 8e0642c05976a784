"""A wall with relief, photographed from a walk before it through known lenses, as an exact model with its matches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.calibration.block import Block, part_of
from colmap_ihe.colmap.calibration.rebuild import Triangulation
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.part_databases import write_images

Float64 = NDArray[np.float64]
SIZE = (1200, 900)
_DISTANCE = 8.0


def camera(
    model: str = "SIMPLE_RADIAL",
    params: Sequence[float] = (1000, 600, 450, -0.05),
    *,
    camera_id: int = 1,
    size: tuple[int, int] = SIZE,
    exif: bool = False,
) -> pycolmap.Camera:
    """A camera with these parameters in COLMAP's order; `exif`: its focal length is said to be from there."""
    made = pycolmap.Camera(model=model, width=size[0], height=size[1], params=params, camera_id=camera_id)
    made.has_prior_focal_length = exif
    return made


def pixels_of(lens: pycolmap.Camera, in_camera: Float64) -> Float64:
    """(N, 2): where a lens shows points (N, 3) of its own axes."""
    return np.asarray(lens.img_from_cam(in_camera), np.float64).reshape(-1, 2)


def poses(count: int, rolls: Sequence[float]) -> list[Float64]:
    """cam_from_world (3, 4) of stations in two lines before a wall in z = 0, which look to +z and its middle. `rolls`
    are degrees about the axis, one after another."""
    found = []
    for number in range(count):
        x = -3.5 + 7 * number / max(1, count - 1)
        centre = np.array([x, -1.2 if number % 2 else 1.2, -_DISTANCE + 0.4 * (number % 3)])
        ahead = np.array([0.45 * x, 0.3 * (number % 3 - 1), 0]) - centre
        ahead /= np.linalg.norm(ahead)
        right = np.cross((0, 1, 0), ahead)
        right /= np.linalg.norm(right)
        down, roll = np.cross(ahead, right), np.radians(rolls[number % len(rolls)])
        across = np.cos(roll) * right + np.sin(roll) * down
        axes = np.array([across, np.cross(ahead, across), ahead])
        found.append(np.column_stack([axes, -axes @ centre]))
    return found


def wall(count: int, rng: np.random.Generator, reach: float = 6.0) -> Float64:
    """(N, 3): points of a wall that stands out and back by 1.2."""
    points = np.column_stack([rng.uniform(-reach, reach, (count, 2)), np.zeros(count)])
    points[:, 2] = 0.7 * np.sin(1.3 * points[:, 0]) * np.cos(points[:, 1]) + rng.uniform(-0.5, 0.5, count)
    return points


def shown(lens: pycolmap.Camera, in_camera: Float64) -> tuple[NDArray[np.intp], Float64]:
    """Which points (N, 3) a photograph shows, (n,), and where, (n, 2); none from beyond where a lens folds."""
    sides = np.array([[0, 0], [lens.width, 0], [0, lens.height], [lens.width, lens.height]], np.float64)
    widest = np.arctan(np.linalg.norm(np.asarray(lens.cam_from_img(sides)), axis=1)).max()
    angles = np.arctan2(np.hypot(in_camera[:, 0], in_camera[:, 1]), in_camera[:, 2])
    near = np.flatnonzero(angles < widest)
    pixels = pixels_of(lens, in_camera[near])
    inside = ((pixels > 0) & (pixels < (lens.width, lens.height))).all(axis=1)
    return near[inside], pixels[inside]


def survey(
    lenses: Sequence[pycolmap.Camera],
    count: int = 8,
    *,
    points: int = 400,
    noise: float = 0.0,
    wrong: float = 0.0,
    rolls: Sequence[float] = (0, 90, 0, -90),
    reach: float = 6.0,
    seed: int = 1,
) -> pycolmap.Reconstruction:
    """The wall as `count` photographs show it, by these lenses in turn: poses, points and cameras are the true ones,
    observations are off by `noise` pixels, and a share of them by 20 to 60."""
    rng = np.random.default_rng(seed)
    model = pycolmap.Reconstruction()
    for lens in lenses:
        model.add_camera_with_trivial_rig(lens)
    xyz = wall(points, rng, reach)
    tracks = [pycolmap.Track() for _ in xyz]
    for number, pose in enumerate(poses(count, rolls)):
        lens = lenses[number % len(lenses)]
        rows, pixels = shown(lens, xyz @ pose[:, :3].T + pose[:, 3])
        pixels = pixels + noise * rng.normal(size=pixels.shape)
        off, way = rng.uniform(20, 60, len(rows)), rng.uniform(0, 2 * np.pi, len(rows))
        far = np.column_stack([off * np.cos(way), off * np.sin(way)])
        pixels += np.where(rng.uniform(size=(len(rows), 1)) < wrong, far, 0)
        image_id = number + 1
        image = pycolmap.Image(
            name=f"{image_id:02}.jpg", keypoints=pixels, camera_id=lens.camera_id, image_id=image_id
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
        for place, row in enumerate(rows):
            tracks[row].add_element(image_id, place)
    for point, track in zip(xyz, tracks, strict=True):
        if track.length() >= 2:
            model.add_point3D(point, track, np.zeros(3, np.uint8))
    return model


def given_cameras(model: pycolmap.Reconstruction, cameras: Sequence[pycolmap.Camera]) -> None:
    """Give a model other cameras, by their ids."""
    for one in cameras:
        model.cameras[one.camera_id].model = one.model
        model.cameras[one.camera_id].params = one.params.tolist()
        model.cameras[one.camera_id].has_prior_focal_length = one.has_prior_focal_length


def moved_a_little(model: pycolmap.Reconstruction, share: float = 0.003, seed: int = 2) -> None:
    """Move poses and points of a model by about a share of the distance of the wall."""
    rng = np.random.default_rng(seed)
    for image in model.images.values():
        turn = pycolmap.Rotation3d(share * rng.normal(size=3))
        pose = pycolmap.Rigid3d(turn, share * _DISTANCE * rng.normal(size=3)) * image.cam_from_world()
        image.frame.set_cam_from_world(image.camera_id, pose)
    for point in model.points3D.values():
        point.xyz = point.xyz + share * _DISTANCE * rng.normal(size=3)


def whole_block(model: pycolmap.Reconstruction) -> tuple[Block, list[pycolmap.Camera]]:
    """The block of all images of a model, and its cameras by their ids."""
    camera_ids = sorted(model.cameras)
    block = part_of(model, sorted(model.reg_image_ids()), camera_ids).block
    return block, [model.cameras[i] for i in camera_ids]


def matches_of(model: pycolmap.Reconstruction) -> dict[tuple[int, int], NDArray[np.uint32]]:
    """The matches of all pairs of images, as the tracks of a model have them."""
    places: dict[int, dict[int, int]] = {}
    for image_id in sorted(model.images):
        seen = enumerate(model.images[image_id].points2D)
        places[image_id] = {p.point3D_id: place for place, p in seen if p.has_point3D()}
    pairs = {}
    for first, second in combinations(places, 2):
        shared = sorted(places[first].keys() & places[second].keys())
        rows = [(places[first][i], places[second][i]) for i in shared]
        pairs[first, second] = np.array(rows, np.uint32).reshape(-1, 2)
    return pairs


def write_database(
    model: pycolmap.Reconstruction, file: Path, cameras: Mapping[int, pycolmap.Camera] | None = None
) -> Path:
    """Write images, keypoints and verified matches of a model, with other cameras by their ids where given."""
    lenses = dict(model.cameras.items()) | dict(cameras or {})
    images = [model.images[i] for i in sorted(model.images)]
    write_images(
        file, {i.image_id: lenses[i.camera_id] for i in images}, {i.image_id: i.name for i in images}
    )
    with pycolmap.Database.open(file) as opened, pycolmap.DatabaseTransaction(opened):
        for image in images:
            pixels = np.array([p.xy for p in image.points2D], np.float32).reshape(-1, 2)
            opened.write_keypoints(image.image_id, pixels)
        for (first, second), rows in matches_of(model).items():
            opened.write_matches(first, second, rows)
            opened.write_two_view_geometry(first, second, _verified(model, first, second, rows))
    return file


def _verified(
    model: pycolmap.Reconstruction, first: int, second: int, rows: NDArray[np.uint32]
) -> pycolmap.TwoViewGeometry:
    there = model.images[second].cam_from_world() * model.images[first].cam_from_world().inverse()
    return pycolmap.TwoViewGeometry(
        config=pycolmap.TwoViewGeometryConfiguration.CALIBRATED,
        inlier_matches=rows,
        cam2_from_cam1=there,
        E=pycolmap.essential_matrix_from_pose(there),
    )


def triangulation_of(model: pycolmap.Reconstruction) -> Triangulation:
    """What the matches of a model say of points."""
    graph = pycolmap.CorrespondenceGraph()
    for image_id in sorted(model.images):
        graph.add_image(image_id, len(model.images[image_id].points2D))
    for (first, second), rows in matches_of(model).items():
        graph.add_two_view_geometry(first, second, _verified(model, first, second, rows))
    graph.finalize()
    return Triangulation(graph)


def position_error(model: pycolmap.Reconstruction, truth: pycolmap.Reconstruction) -> float:
    """The mean distance of camera centres from the truth after the best similarity, in its units."""
    ids = sorted(model.reg_image_ids())
    centres, true = (np.array([one.images[i].projection_center() for i in ids]) for one in (model, truth))
    fit = pycolmap.estimate_sim3d(centres, true)
    return float(np.linalg.norm(fit * centres - true, axis=1).mean())
