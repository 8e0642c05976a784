"""Simulate sets of photographs through known lenses, as COLMAP databases with matches, and try COLMAP on them.

    python benchmarks/lens_sets.py [--images 4 10 30] [--scenes facade ...] [--lenses barrel ...] [--seed 1]

No photograph is made: features lie on the surfaces of a place (lens_scenes.py), are seen where nothing hides them, are
found again the less the view has turned, and are matched with some mistakes (lens_features.py); COLMAP verifies pairs.
The table says, for each place and lens: photographs registered, points, mean track length, mean reprojection error,
mean position error of COLMAP's default in millimetres, that after one more bundle adjustment with the principal point
free, and that of a model from the true lens: no calibration can do much better.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lens_features import centre_of, keypoints, matches, sight
from lens_kinds import LENSES, start_camera, true_camera, view_of
from lens_scenes import PLACES
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table

SCENES: tuple[str, ...] = tuple(PLACES)


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
    pairs. `points`: features an image, about. One seed gives one place, and lenses of one view one walk."""
    streams = [np.random.default_rng([seed, stream]) for stream in range(4)]
    place_rng, lens_rng, feature_rng, noise_rng = streams
    camera = true_camera(lens, size, lens_rng)
    panels, poses = PLACES[scene](images, view_of(camera), place_rng)
    with threadpool_limits(1):  # many small products of matrices
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


def write_camera_model(database: Path, model: str) -> None:
    """Make the camera of a database another model of COLMAP's, of the same focal length, without distortion."""
    with pycolmap.Database.open(database) as opened:
        old = opened.read_camera(1)
    new = pycolmap.Camera.create_from_model_name(1, model, old.mean_focal_length(), old.width, old.height)
    new.has_prior_focal_length = old.has_prior_focal_length
    write_camera(database, new)


def write_camera(database: Path, camera: pycolmap.Camera) -> None:
    """Put another camera in the place of a database's; the pairs keep what was verified with the old one."""
    with pycolmap.Database.open(database) as opened:
        opened.update_camera(camera)


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
    """Reconstruct a database by COLMAP's default with one thread: the model of most photographs, None without any."""
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=0, extract_colors=False)
    models = pycolmap.incremental_mapping(database, folder, folder, options)
    return max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)


def best_model(made: LensSet, folder: Path) -> pycolmap.Reconstruction:
    """Return the model that the true lens leads to: pairs verified with it, points from the true poses, then all but
    the lens adjusted. What it is off by is the fault of the features."""
    camera, database = pycolmap.Camera(made.truth.todict()), folder / f"{made.name}-truth.db"
    camera.has_prior_focal_length = True
    shutil.copy(made.database, database)
    write_camera(database, camera)
    verify(database)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for image_id, (name, matrix) in enumerate(made.poses.items(), start=1):
        image = pycolmap.Image(name=name, camera_id=1, image_id=image_id)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(matrix))
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=0, extract_colors=False)
    model = pycolmap.triangulate_points(model, database, folder, folder, options=options)
    adjust(model, pycolmap.BundleAdjustmentOptions(refine_focal_length=False, refine_extra_params=False))
    return model


def free_principal_point(model: pycolmap.Reconstruction) -> None:
    """Adjust a model once more, with the principal point free."""
    adjust(model, pycolmap.BundleAdjustmentOptions(refine_principal_point=True))


def adjust(model: pycolmap.Reconstruction, options: pycolmap.BundleAdjustmentOptions) -> None:
    """Adjust all of a model. As pycolmap.bundle_adjustment, which turns COLMAP's log to stderr on again."""
    options.print_summary = False
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()


def _row(made: LensSet, folder: Path) -> tuple[str, ...]:
    floor = f"{position_error_mm(best_model(made, folder), made.poses):.1f}"
    began = time.monotonic()
    model = reconstruct(made.database, folder)
    seconds = f"{time.monotonic() - began:.1f}"
    if model is None:
        return (made.scene, made.lens, f"0 of {made.images}", *"-----", floor, seconds)
    found = (
        f"{model.num_reg_images()} of {made.images}",
        f"{model.num_points3D()}",
        f"{model.compute_mean_track_length():.2f}",
        f"{model.compute_mean_reprojection_error():.3f}",
        f"{position_error_mm(model, made.poses):.1f}",
    )
    free_principal_point(model)
    return (made.scene, made.lens, *found, f"{position_error_mm(model, made.poses):.1f}", floor, seconds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, nargs="+", default=[10])
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument("--lenses", nargs="+", default=tuple(LENSES))
    parser.add_argument("--seed", type=int, default=1)
    parsed = parser.parse_args()
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    head = (
        "scene",
        "lens",
        "registered",
        "points",
        "track",
        "px",
        "mm",
        "mm, pp free",
        "mm, true lens",
        "s",
    )
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
