"""Read the calibration file that a run was given, tell which cameras the mapping holds, and write what it found."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.calibration_file import (
    CalibratedCamera,
    cameras_of,
    read_calibration,
    write_calibration,
)
from colmap_ihe.colmap.mapper_options import camera_ids, refuse_partly_held
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import CalibrationFileError
from colmap_ihe.photographs.camera_identity import read_identities
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


def given_calibration(project: Project, options: Options) -> list[CalibratedCamera]:
    """Return the cameras of the calibration file that was given, none without one. Raises `CalibrationFileError`."""
    if options.camera.calibration is None:
        return []
    file = project.root / options.camera.calibration
    cameras = read_calibration(file)
    if Path(os.path.realpath(file)).is_relative_to(os.path.realpath(project.report)):
        raise CalibrationFileError(
            f"{file}: lies in {project.report.name}/, which each run writes anew",
            hint="copy it into the project's folder, and name the copy as camera.calibration",
        )
    return cameras


def write_found_calibration(project: Project, folder: Path, record: Mapping[str, Any]) -> None:
    """Write the cameras of a project's model in `folder`, as the record of `sparse` describes it, for other
    campaigns."""
    model = pycolmap.Reconstruction(folder)
    names = [str(model.images[i].name) for i in model.reg_image_ids()]
    deviations = {
        c["camera_id"]: c["standard_deviations"] for c in record["cameras"] if c["standard_deviations"]
    }
    cameras = cameras_of(model, read_identities(project.grey, names), deviations)
    write_calibration(project.calibration_file, cameras)


def held_cameras(project: Project, options: Options, features: Mapping[str, Any]) -> frozenset[int]:
    """Return the ids of the cameras that the mapping holds as they are in the database: those that start from the
    calibration file, by the record of `features`, or all if their parameters were given. Raises `CalibrationFileError`
    where `camera.fixed` finds no camera to hold, `OptionError` where the mapper cannot hold only some."""
    if not options.camera.fixed:
        return frozenset()
    every = camera_ids(project.database)
    if options.camera.calibration is None:
        return every
    held = frozenset(features["calibration"]["camera_ids"])
    if not held:
        raise CalibrationFileError(
            f"{options.camera.calibration}: no camera of it took any of the photographs, so camera.fixed has none to"
            " hold",
            hint="leave out camera.calibration and camera.fixed, or give the calibration of these cameras",
        )
    refuse_partly_held(options.sparse, held, every)
    return held
