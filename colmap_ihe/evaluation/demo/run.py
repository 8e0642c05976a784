"""Render the demo, reconstruct it, and compare the model with the truth."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.colmap.measures import poses_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.depth_maps import depth_file, read_planes, sgm_depth_maps
from colmap_ihe.dense.undistort import undistort
from colmap_ihe.errors import ProjectError
from colmap_ihe.evaluation.demo.paintings import painted_depth_percent, panel_pixels
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.evaluation.depth_errors import depth_errors, pooled
from colmap_ihe.evaluation.truth import F32, F64, TrueImage, Truth, key_of, pose_errors, read_truth
from colmap_ihe.machine.files import write_json
from colmap_ihe.machine.libraries import library_versions
from colmap_ihe.machine.progress import RunProgress
from colmap_ihe.machine.scratch import scratch_folder
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.pipeline.summary import report
from colmap_ihe.project.options_file import project_options


def demo(folder: Path, assignments: list[str], progress: RunProgress) -> Reconstruction:
    """Render the demo into `folder`, reconstruct it, and add its errors to the summary and the page. Raises
    `ProjectError` for a folder with other photographs, `CapabilityError` without pycolmap, and other `KnownError`s."""
    if (folder / "images").exists() and not (folder / "truth").exists():
        raise ProjectError(
            f"{folder}: holds photographs that are not the demo's", hint="name another folder for the demo"
        )
    library_versions("pycolmap")  # raises where there is none, before minutes of rendering
    options = project_options(folder, assignments)
    with progress.stage("render") as stage_progress:
        render_demo(folder, progress=stage_progress)
    done = reconstruct(folder, options, progress=progress)
    truth = truth_summary(done, read_truth(folder / "truth"), options.dense.max_image_size)
    summary = {**done.summary, "truth": truth}
    write_json(done.project.summary_file, summary)
    if done.project.page_file.exists():
        report(folder, assignments, progress=progress)  # now with the truth
    return replace(done, summary=summary)


def truth_summary(done: Reconstruction, truth: Truth, max_image_size: int = -1) -> dict[str, Any]:
    """Return the section `truth` of summary.json; without a dense cloud, only the errors of poses. A depth is right
    within 2 %: shares of right ones are of the pixels that see the scene, of wrong ones of the depths;
    painted panels have their shares by name."""
    poses = pose_errors(poses_of(done.sparse_model), truth)
    section: dict[str, Any] = {
        "rotation_error_deg": poses.rotation_error_deg,
        "position_error_percent": poses.position_error_percent,
    }
    if done.summary["dense_points"] is not None:
        scale = poses.world_from_model.scale
        depth = pooled(depth_errors(*each, scale) for each in _depth_maps(done.project.dense, truth))
        section["dense_median_error_percent"] = depth.median_percent
        section["depth_right_percent"] = depth.all.right_percent
        section["depth_wrong_percent"] = depth.all.wrong_percent
        section["depth_right_near_edges_percent"] = depth.near_edges.right_percent
        section["depth_wrong_near_edges_percent"] = depth.near_edges.wrong_percent
        dense = done.project.dense
        section["painted_depth_percent"] = painted_depth_percent(_depth_maps(dense, truth), scale)
        if done.summary["second_grey"] is not None:
            section |= _beside_one_grey(done, truth, scale, max_image_size)
    return section


def _beside_one_grey(
    done: Reconstruction, truth: Truth, scale: float, max_image_size: int
) -> dict[str, dict[str, float]]:
    """Return the shares of the painted panels in the photograph that sees most of them, and what they are where stereo
    sees the first grey alone."""
    project, names = done.project, sorted(poses_of(done.sparse_model))
    seen = {name: sum(p.sum() for p in panel_pixels(truth.images[key_of(name)]).values()) for name in names}
    most = max(names, key=lambda name: seen[name])
    with scratch_folder() as folder:
        undistort(done.sparse_model, project.grey, project.colour, folder, max_image_size=max_image_size)
        sgm_depth_maps(folder, only=[most])
        greys = {"two greys": project.dense, "one grey": folder}
        return {
            f"painted_depth_in_{key_of(most)}_by_{words.replace(' ', '_')}_percent": painted_depth_percent(
                _depth_maps(dense, truth, [most]), scale
            )
            for words, dense in greys.items()
        }


def _depth_maps(
    dense: Path, truth: Truth, only: Collection[str] = ()
) -> Iterator[tuple[F32, F64, TrueImage]]:
    """Yield depth, calibration and truth of each image, or `only` of those named."""
    model = pycolmap.Reconstruction(dense / "sparse")
    images = [model.images[image_id] for image_id in model.reg_image_ids()]
    for image in images:
        if only and image.name not in only:
            continue
        depth = np.asarray(read_planes(depth_file(dense, image.name))[0])
        calibration = model.cameras[image.camera_id].calibration_matrix()
        yield depth, calibration, truth.images[key_of(image.name)]
