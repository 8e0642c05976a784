"""Calibrate the models of a mapping, and map once more where COLMAP's camera model could not show the lens."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from colmap_ihe.colmap.calibration.calibrate import Calibration, Known, calibrate
from colmap_ihe.colmap.calibration.rebuild import Triangulation
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import Progress

Models = list[pycolmap.Reconstruction]
Calibrations = list[Calibration | None]


def known_of(database: Path, known: Known) -> Known:
    """Return what is known with the cameras of a database."""
    with pycolmap.Database.open(database) as opened:
        return replace(known, cameras={camera.camera_id: camera for camera in opened.read_all_cameras()})


def calibrate_models(
    models: Models,
    database: Path,
    known: Known,
    settings: pycolmap.IncrementalPipelineOptions,
    map_again: Callable[[Path], Models],
    scratch: Path,
    progress: Progress,
) -> tuple[Models, Calibrations]:
    """Return the models with their cameras calibrated, and what came of it.

    `settings` of COLMAP's mapper say how points are triangulated and filtered. Where a lens is another than COLMAP's
    model shows, `map_again` maps by a copy of the database in `scratch` whose cameras are those found, which places
    more photographs, and these models are calibrated; unless fewer photographs were placed.
    """
    known = known_of(database, known)
    first = [_calibrated(model, database, known, settings, progress) for model in models]
    found = first[0]
    if found is None or not found.other_lens:
        return models, first
    copy = scratch / "found-cameras.db"
    shutil.copyfile(database, copy)
    _start_from(copy, models[0], found)
    again = map_again(copy)
    again.sort(key=lambda model: (-model.num_reg_images(), -model.num_points3D()))
    if not again or again[0].num_reg_images() < models[0].num_reg_images():
        return models, first
    starts = replace(known, starts=found.freedoms)
    return again, [_calibrated(model, database, starts, settings, progress) for model in again]


def _start_from(database: Path, model: pycolmap.Reconstruction, found: Calibration) -> None:
    with pycolmap.Database.open(database) as opened:
        for camera_id in found.freedoms:
            camera = opened.read_camera(camera_id)
            camera.model = model.cameras[camera_id].model
            camera.params = model.cameras[camera_id].params.tolist()
            opened.update_camera(camera)


def _calibrated(
    model: pycolmap.Reconstruction,
    database: Path,
    known: Known,
    settings: pycolmap.IncrementalPipelineOptions,
    progress: Progress,
) -> Calibration | None:
    options = pycolmap.DatabaseCacheOptions(
        min_num_matches=settings.min_num_matches,
        ignore_watermarks=settings.ignore_watermarks,
        image_names={str(model.images[i].name) for i in model.reg_image_ids()},
    )
    with pycolmap.Database.open(database) as opened:
        cache = pycolmap.DatabaseCache.create(opened, options)
    mapper = settings.get_mapper()
    triangulation = Triangulation(
        cache.correspondence_graph,
        settings.get_triangulation(),
        mapper.filter_max_reproj_error,
        mapper.filter_min_tri_angle,
    )
    return calibrate(model, known, triangulation, progress)
