"""Simulate sets of photographs through known lenses, as COLMAP databases with matches, and try COLMAP on them.

    python benchmarks/lens_sets.py [--images 4 10 30] [--scenes facade ...] [--lenses barrel ...] [--seed 1]

No photograph is made: features lie on the surfaces of a place (lens_scenes.py), are seen where nothing hides them, are
found again the less the view has turned, and are matched with some mistakes (lens_features.py); COLMAP verifies pairs.
The table says, for each place and lens: photographs registered, points, mean track length, mean reprojection error,
mean position error of COLMAP's default in millimetres, and that after one more bundle adjustment with the principal
point free.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lens_features import centre_of, keypoints, matches, ray_angles, sight
from lens_scenes import PLACES, View
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table

Parameters = tuple[float, ...]
Draw = Callable[[np.random.Generator], Parameters]

SCENES: tuple[str, ...] = tuple(PLACES)


@dataclass(frozen=True)
class Lens:
    """Describe a kind of lens: COLMAP's model, the range of focal lengths in longer sides, and what draws the rest."""

    model: str
    focal: tuple[float, float]
    distortion: Draw


def _ranges(*ranges: tuple[float, float]) -> Draw:
    return lambda rng: tuple(float(rng.uniform(low, high)) for low, high in ranges)


def _decentred(rng: np.random.Generator) -> Parameters:
    k1, k2, size, way = rng.uniform((-0.12, 0, 0.7e-3, 0), (-0.04, 0.04, 1.5e-3, 2 * np.pi)).tolist()
    return k1, k2, float(size * np.cos(way)), float(size * np.sin(way))


def _moustache(rng: np.random.Generator) -> Parameters:
    k1, k2, k3 = rng.uniform((-0.14, 0.12, -0.06), (-0.10, 0.18, -0.02)).tolist()
    return k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0


_USUAL = (0.75, 1.4)
LENSES: Mapping[str, Lens] = {
    "none": Lens("SIMPLE_PINHOLE", _USUAL, _ranges()),
    "barrel": Lens("SIMPLE_RADIAL", _USUAL, _ranges((-0.15, -0.05))),
    "barrel2": Lens("RADIAL", _USUAL, _ranges((-0.15, -0.05), (0.01, 0.06))),
    "pincushion": Lens("SIMPLE_RADIAL", _USUAL, _ranges((0.03, 0.08))),
    "decentred": Lens("OPENCV", _USUAL, _decentred),
    "complex": Lens("FULL_OPENCV", _USUAL, _moustache),
    "fisheye": Lens(
        "OPENCV_FISHEYE",
        (0.53, 0.69),
        _ranges((-0.03, 0.03), (-0.01, 0.01), (-0.004, 0.004), (-0.001, 0.001)),
    ),
    "strong": Lens("RADIAL", (0.5, 0.7), _ranges((-0.32, -0.27), (0.09, 0.11))),
}
"""By name. A name with "+1" behind it has its principal point 1 % of the longer side off the middle."""


@dataclass(frozen=True)
class LensSet:
    """Hold a simulated set: `truth` is the camera in pixels, `poses` cam_from_world (3, 4) in metres by image name."""

    name: str
    scene: str
    lens: str
    images: int
    truth: pycolmap.Camera
    poses: dict[str, NDArray[np.float64]]
    database: Path


def true_camera(lens: str, size: tuple[int, int], rng: np.random.Generator) -> pycolmap.Camera:
    """Draw a camera of a kind of lens. ValueError where the lens is unknown or folds within the picture."""
    name, _, per_cent = lens.partition("+")
    if name not in LENSES:
        raise ValueError(
            f"lens {lens!r} is not known: take one of {', '.join(LENSES)}, with +1 behind it for 1 % off"
        )
    kind, longer = LENSES[name], max(size)
    focal, way, off = rng.uniform((kind.focal[0], 0, 0), (kind.focal[1], 2 * np.pi, 2)).tolist()
    distortion = kind.distortion(rng)
    shift = (float(per_cent) if per_cent else off) / 100 * longer
    middle = (size[0] / 2 + shift * np.cos(way), size[1] / 2 + shift * np.sin(way))
    single = kind.model.startswith("SIMPLE") or kind.model == "RADIAL"
    lengths = (focal * longer,) if single else (focal * longer, focal * longer)
    camera = pycolmap.Camera(
        model=kind.model, width=size[0], height=size[1], params=[*lengths, *middle, *distortion], camera_id=1
    )
    farthest = [
        0.0 if place > half else 2 * half for place, half in zip(middle, np.array(size) / 2, strict=True)
    ]
    angles = ray_angles(camera, np.linspace(farthest, middle, 400))
    if not (np.diff(angles) < 0).all():
        raise ValueError(f"lens {lens} folds within the picture: {camera.params_to_string()}")
    return camera


def _view(camera: pycolmap.Camera) -> View:
    x, y = camera.principal_point_x, camera.principal_point_y
    side, top = ray_angles(camera, np.array([[camera.width, y], [x, 0.0]])).tolist()
    return View(side, top)


def simulate(
    folder: Path,
    scene: str,
    lens: str,
    images: int,
    seed: int,
    *,
    size: tuple[int, int] = (1600, 1067),
    prior_focal: bool = True,
    noise_px: float = 0.5,
    points: int = 3000,
) -> LensSet:
    """Simulate a set below `folder`: its database has one camera as COLMAP begins with, features, matches and verified
    pairs. `points`: features an image, about. One seed gives one place and one walk, whatever the lens."""
    place_rng, lens_rng, feature_rng, noise_rng = (
        np.random.default_rng([seed, stream]) for stream in range(4)
    )
    camera = true_camera(lens, size, lens_rng)
    panels, poses = PLACES[scene](images, _view(camera), place_rng)
    sightings = sight(panels, camera, poses, points, feature_rng)
    rows = [noise_rng.permutation(np.flatnonzero(row)) for row in sightings.found]
    names = [f"{number:04d}.jpg" for number in range(images)]
    name = f"{scene}-{lens}-{images}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    database = folder / f"{name}.db"
    database.unlink(missing_ok=True)
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        _write_images(opened, start_camera(camera, prior_focal, lens_rng), names)
        for image_id, (row, pose) in enumerate(zip(rows, poses, strict=True), start=1):
            part = sightings.features.of(row)
            opened.write_keypoints(image_id, keypoints(part, camera, pose, noise_px, noise_rng))
        for first, second, pair in matches(rows, sightings.looks, sightings.features.known, noise_rng):
            opened.write_matches(first + 1, second + 1, pair)
    verify(database, seed)
    return LensSet(name, scene, lens, images, camera, dict(zip(names, poses, strict=True)), database)


def start_camera(truth: pycolmap.Camera, prior_focal: bool, rng: np.random.Generator) -> pycolmap.Camera:
    """Return the camera that COLMAP begins with: SIMPLE_RADIAL, its focal length from EXIF or guessed."""
    longer = max(truth.width, truth.height)
    focal = truth.mean_focal_length() * rng.uniform(0.985, 1.015) if prior_focal else 1.2 * longer
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", focal, truth.width, truth.height)
    camera.has_prior_focal_length = prior_focal
    return camera


def write_camera_model(database: Path, model: str) -> None:
    """Make the camera of a database another model of COLMAP's, of the same focal length, without distortion."""
    with pycolmap.Database.open(database) as opened:
        old = opened.read_camera(1)
        new = pycolmap.Camera.create_from_model_name(1, model, old.mean_focal_length(), old.width, old.height)
        new.has_prior_focal_length = old.has_prior_focal_length
        opened.update_camera(new)


def verify(database: Path, seed: int = 0) -> None:
    """Verify the matches of a database anew, by COLMAP with one thread."""
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed
    with pycolmap.Database.open(database) as opened:
        opened.clear_two_view_geometries()
    pycolmap.geometric_verification(
        database, pycolmap.GeometricVerifierOptions(num_threads=1), two_view_geometry_options=options
    )


def _write_images(opened: pycolmap.Database, camera: pycolmap.Camera, names: list[str]) -> None:
    opened.write_camera(camera, use_camera_id=True)
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(camera.sensor_id)
    opened.write_rig(rig, use_rig_id=True)
    for image_id, name in enumerate(names, start=1):
        image = pycolmap.Image(name=name, camera_id=1, image_id=image_id)
        frame = pycolmap.Frame(frame_id=image_id, rig_id=1)
        frame.add_data_id(image.data_id)
        opened.write_frame(frame, use_frame_id=True)
        image.frame_id = image_id
        opened.write_image(image, use_image_id=True)


def position_error_mm(model: pycolmap.Reconstruction, poses: Mapping[str, NDArray[np.float64]]) -> float:
    """Return the mean distance of camera centres from the truth after the best similarity; nan with fewer than 3."""
    images = [image for image in model.images.values() if image.has_pose]
    if len(images) < 3:
        return float("nan")
    centres = np.array([image.projection_center() for image in images])
    truth = np.array([centre_of(poses[image.name]) for image in images])
    fit = pycolmap.estimate_sim3d(centres, truth)
    if fit is None:
        return float("nan")
    return float(1000 * np.linalg.norm(fit * centres - truth, axis=1).mean())


def reconstruct(database: Path, folder: Path) -> pycolmap.Reconstruction | None:
    """Reconstruct a database by COLMAP's default with one thread; the largest model, None where there is none."""
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=0, extract_colors=False)
    models = pycolmap.incremental_mapping(database, folder, folder, options)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def free_principal_point(model: pycolmap.Reconstruction) -> None:
    """Adjust a model once more, with the principal point free."""
    # pycolmap.bundle_adjustment would do, but it turns COLMAP's log to stderr on again.
    options = pycolmap.BundleAdjustmentOptions(refine_principal_point=True, print_summary=False)
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()


def _row(made: LensSet, folder: Path) -> tuple[str, ...]:
    began = time.monotonic()
    model = reconstruct(made.database, folder)
    seconds = time.monotonic() - began
    if model is None:
        return (made.scene, made.lens, f"0 of {made.images}", *"-----", f"{seconds:.1f}")
    found = (
        f"{model.num_reg_images()} of {made.images}",
        f"{model.num_points3D()}",
        f"{model.compute_mean_track_length():.2f}",
        f"{model.compute_mean_reprojection_error():.3f}",
        f"{position_error_mm(model, made.poses):.1f}",
    )
    free_principal_point(model)
    freed = f"{position_error_mm(model, made.poses):.1f}"
    return (made.scene, made.lens, *found, freed, f"{seconds:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, nargs="+", default=[10])
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument("--lenses", nargs="+", default=tuple(LENSES))
    parser.add_argument("--seed", type=int, default=1)
    parsed = parser.parse_args()
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    head = ("scene", "lens", "registered", "points", "track", "px", "mm", "mm, pp free", "s")
    for images in parsed.images:
        rows = []
        for scene in parsed.scenes:
            for lens in parsed.lenses:
                with tempfile.TemporaryDirectory() as folder:
                    made = simulate(Path(folder), scene, lens, images, parsed.seed)
                    rows.append(_row(made, Path(folder)))
        print_table(f"{images} photographs", rows, head)


if __name__ == "__main__":
    main()
