"""Make a block of photographs before a façade as COLMAP would leave it: adjusted, in a frame of its own, bent a little.

Metres; x right along the façade, y into it, z up, as in a local system of a survey.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.observations import Observation

F64 = NDArray[np.float64]
WIDTH, HEIGHT, FOCAL = 1600, 1200, 1400.0
SCALE, SHIFT = 0.37, np.array((3.0, -2.0, 11.0))


@dataclass(frozen=True)
class SurveyBlock:
    """Hold the model, and the truth: named points (3,), camera centres (3,) by image, and sights of the points."""

    model: pycolmap.Reconstruction
    named: dict[str, F64]
    centres: dict[str, F64]
    sights: list[Observation]


def survey_block(
    photographs: int = 12,
    named: int = 8,
    ties: int = 400,
    seed: int = 0,
    noise_px: float = 0.4,
    *,
    bent: bool = False,
) -> SurveyBlock:
    """Return a block of photographs in two rows before a façade of 20 by 8 m, whose model is what a free adjustment of
    noisy observations makes of it; `bent` by a lens whose distortion and principal point are not known."""
    draw = np.random.default_rng(seed)
    poses = [_pose(n, photographs) for n in range(photographs)]
    points = draw.uniform((-10, -2.0, 0), (10, 1.0, 8), (ties, 3))
    places = _spread(named)
    truth = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, WIDTH, HEIGHT)
    truth.params = [FOCAL, WIDTH / 2 + 6, HEIGHT / 2 - 4, -0.03]
    model = _model(truth, poses, points, draw, noise_px, bent)
    sights = [
        Observation(f"{n}.png", name, *_seen(truth, pose, place, draw, 0.1), 0.1)
        for n, pose in enumerate(poses)
        for name, place in places.items()
        if _inside(truth, pose, place)
    ]
    centres = {f"{n}.png": -pose[:, :3].T @ pose[:, 3] for n, pose in enumerate(poses)}
    return SurveyBlock(model, places, centres, sights)


def _spread(count: int) -> dict[str, F64]:
    draw = np.random.default_rng(99)
    columns = np.linspace(-6.5, 6.5, (count + 1) // 2)
    return {
        f"T{n}": np.array((columns[n // 2], draw.uniform(-0.7, 0.7), 1.0 if n % 2 else 7.0))
        for n in range(count)
    }


def _pose(number: int, count: int) -> F64:
    """Return `cam_from_world` (3, 4) of a camera that looks at the façade, a little to one side."""
    column, row = number // 2, number % 2
    centre = np.array(
        (-9 + 18 * column / max(1, (count - 1) // 2), -7.0 - 2.5 * (number % 3), 1.7 + 3.5 * row)
    )
    turn, tilt = np.radians(-1.2 * centre[0] + ((number * 37) % 25) - 12), np.radians(6 - 10 * row)
    forward = np.array((np.sin(turn) * np.cos(tilt), np.cos(turn) * np.cos(tilt), np.sin(tilt)))
    right = np.cross(forward, (0, 0, 1))
    right = right / np.linalg.norm(right)
    rotation = np.stack((right, np.cross(forward, right), forward))
    return np.concatenate((rotation, (-rotation @ centre)[:, None]), axis=1)


def _inside(camera: pycolmap.Camera, pose: F64, point: F64) -> bool:
    x, y = _seen(camera, pose, point, np.random.default_rng(0), 0.0)
    return bool(20 < x < WIDTH - 20 and 20 < y < HEIGHT - 20)


def _seen(
    camera: pycolmap.Camera, pose: F64, point: F64, draw: np.random.Generator, noise_px: float
) -> tuple[float, float]:
    pixel = camera.img_from_cam(pose[:, :3] @ point + pose[:, 3])
    x, y = (np.full(2, -1.0) if pixel is None else np.asarray(pixel)) + draw.normal(0, noise_px, 2)
    return float(x), float(y)


def _model(
    truth: pycolmap.Camera,
    poses: list[F64],
    points: F64,
    draw: np.random.Generator,
    noise_px: float,
    bent: bool,
) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, WIDTH, HEIGHT)
    model.add_camera_with_trivial_rig(camera)
    tracks: list[list[tuple[int, int]]] = [[] for _ in points]
    for number, pose in enumerate(poses):
        seen = [n for n, point in enumerate(points) if _inside(truth, pose, point)]
        pixels = [_seen(truth, pose, points[n], draw, noise_px) for n in seen]
        image = pycolmap.Image(
            name=f"{number}.png", keypoints=np.array(pixels).reshape(-1, 2), camera_id=1, image_id=number + 1
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
        for place, n in enumerate(seen):
            tracks[n].append((number + 1, place))
    for point, track in zip(points, tracks, strict=True):
        if len(track) > 1:
            elements = [pycolmap.TrackElement(image, place) for image, place in track]
            model.add_point3D(point, pycolmap.Track(elements), np.zeros(3, np.uint8))
    turn = pycolmap.Rotation3d(np.array((0.3, -0.5, 1.1)))
    model.transform(pycolmap.Sim3d(SCALE, turn, SHIFT))
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = options.refine_extra_params = not bent
    options.print_summary = False
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()
    for point_id in [i for i, point in model.points3D.items() if not point.error < 4]:
        model.delete_point3D(point_id)  # as COLMAP filters
    return model
