"""The demo's error against its truth, added to the summary of its reconstruction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.evaluation.depth_errors import DepthErrors, depth_errors, pooled, truth_summary
from colmap_ihe.evaluation.truth import Truth, key_of, pose_errors, read_truth
from colmap_ihe.machine.files import write_json
from colmap_ihe.pipeline.reconstruct import Reconstruction


def add_truth(done: Reconstruction, truth_folder: Path) -> Reconstruction:
    """The same with `truth` in its summary, in memory and in report/summary.json."""
    truth = read_truth(truth_folder)
    model = pycolmap.Reconstruction(done.sparse_model)
    poses = {model.images[i].name: model.images[i].cam_from_world().matrix() for i in model.reg_image_ids()}
    errors = pose_errors(poses, truth)
    depth = None
    if done.summary["dense_points"] is not None:
        depth = _depth_errors(done, truth, errors.world_from_model.scale)
    summary = {**done.summary, "truth": truth_summary(errors, depth)}
    write_json(done.project.summary_file, summary)
    return replace(done, summary=summary)


def _depth_errors(done: Reconstruction, truth: Truth, metres_per_unit: float) -> DepthErrors:
    dense = done.project.dense
    model = pycolmap.Reconstruction(dense / "sparse")
    found = []
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        depth_map = pycolmap.DepthMap()
        depth_map.read(dense / "stereo" / "depth_maps" / f"{image.name}.geometric.bin")
        calibration = model.cameras[image.camera_id].calibration_matrix()
        true_image = truth.images[key_of(image.name)]
        found.append(depth_errors(depth_map.to_array(), calibration, true_image, metres_per_unit))
    return pooled(found)
