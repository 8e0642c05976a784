"""Give a model the cameras, poses and points of a calibration, and triangulate by them what it has not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from colmap_ihe.colmap.calibration.adjust import place
from colmap_ihe.colmap.calibration.block import Block, Part, poses_of
from colmap_ihe.colmap.native import called, fill, pycolmap
from colmap_ihe.machine.progress import SILENT, Progress


def _usual_options() -> pycolmap.IncrementalTriangulatorOptions:
    return pycolmap.IncrementalTriangulatorOptions()


@dataclass(frozen=True)
class Triangulation:
    """Hold the matches of the database, COLMAP's options and limits for points, as its mapper has them, and how many
    threads may adjust poses, -1 for all."""

    graph: pycolmap.CorrespondenceGraph
    options: pycolmap.IncrementalTriangulatorOptions = field(default_factory=_usual_options)
    most_error_px: float = 4.0
    least_angle: float = 1.5
    threads: int = -1


def give(
    model: pycolmap.Reconstruction,
    part: Part,
    cameras: Sequence[pycolmap.Camera],
    poses: Block,
    sigma: float,
) -> None:
    """Give a part of a model these cameras, and its images the poses of a block; the points follow, by observations of
    standard deviation `sigma` in pixels."""
    for camera_id, camera in zip(part.camera_ids, cameras, strict=True):
        model.cameras[camera_id].model = camera.model
        model.cameras[camera_id].params = camera.params.tolist()
    for image_id, rotation, translation in zip(
        part.image_ids, poses.rotations, poses.translations, strict=True
    ):
        image = model.images[image_id]
        pose = pycolmap.Rigid3d(np.concatenate([rotation, translation[:, None]], axis=1))
        frame = image.frame
        assert frame is not None  # of a model that is read or mapped every image has one
        frame.set_cam_from_world(image.camera_id, pose)
    rotations, translations = poses_of(model, part.image_ids)
    block = place(replace(part.block, rotations=rotations, translations=translations), cameras, sigma)
    for point_id, xyz in zip(part.point_ids.tolist(), block.points, strict=True):
        model.points3D[point_id].xyz = xyz


def adjust_poses(model: pycolmap.Reconstruction, progress: Progress, threads: int = -1) -> None:
    """Adjust poses and points of a model by COLMAP, with the cameras held: of those too large to adjust here."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
    options.print_summary = False
    fill(options, {"num_threads": threads})
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    # Not pycolmap.bundle_adjustment, which sends COLMAP's log to stderr from then on.
    adjuster = pycolmap.create_default_bundle_adjuster(options, config, model)
    called(adjuster.solve, progress=progress, cancellable=False)


def triangulate(model: pycolmap.Reconstruction, given: Triangulation, progress: Progress = SILENT) -> None:
    """Add to a model, merge and filter what its cameras and poses say of the matches, as COLMAP's mapper does. Raises
    `Cancelled`."""
    observed = pycolmap.ObservationManager(model, given.graph)
    triangulator = pycolmap.IncrementalTriangulator(given.graph, model, observed)
    observed.filter_all_points3D(given.most_error_px, given.least_angle)
    for step in (triangulator.complete_all_tracks, triangulator.merge_all_tracks, triangulator.retriangulate):
        called(step, given.options, progress=progress, cancellable=False)
    for image_id in sorted(model.reg_image_ids()):
        triangulator.triangulate_image(given.options, image_id)
        progress.check()
    observed.filter_all_points3D(given.most_error_px, given.least_angle)
    model.update_point_3d_errors()
