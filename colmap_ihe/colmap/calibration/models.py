"""Calibrate the models of a mapping, and map once more where COLMAP's camera model could not show the lens."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from colmap_ihe.colmap.calibration.calibrate import Apart, Calibration, Known, calibrate
from colmap_ihe.colmap.calibration.choose import may_be_wide
from colmap_ihe.colmap.calibration.freedom import PERSPECTIVE
from colmap_ihe.colmap.calibration.rebuild import Triangulation
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.part_databases import copy_with_cameras
from colmap_ihe.machine.progress import Progress

Models = list[pycolmap.Reconstruction]
Calibrations = list[Calibration | None]
Outcomes = Sequence[Calibration | Apart | None]
Groups = list[list[str]]
MapAgain = Callable[[Path], Models]

_LITTLE = 0.25
"""Share of matched features in a model below which mapping failed: 0.02 to 0.24 where it did, of simulated fisheyes,
0.3 to 0.9 elsewhere (0.45 of strangers' photographs)."""
_MORE = 1.5  # times the observations, for a model that began otherwise


def known_of(database: Path, known: Known) -> Known:
    """Return what is known with the cameras of a database. Those without a focal length from EXIF are only assumed to
    have taken all their images, if that is to be checked."""
    with pycolmap.Database.open(database) as opened:
        cameras = {int(camera.camera_id): camera for camera in opened.read_all_cameras()}
    unproved = frozenset(i for i, camera in cameras.items() if not camera.has_prior_focal_length)
    return replace(
        known, cameras=cameras, assumed=unproved - known.held if known.check_shared else frozenset()
    )


def calibrate_models(
    models: Models,
    database: Path,
    known: Known,
    settings: pycolmap.IncrementalPipelineOptions,
    map_again: MapAgain,
    scratch: Path,
    progress: Progress,
) -> tuple[Models, Calibrations, Groups]:
    """Return the models with their cameras calibrated, what came of it, and the images by name in groups of one camera
    each, where a camera was only assumed to have taken them all and clearly had not.

    `settings` of COLMAP's mapper say how points are triangulated and filtered. Then, and where a lens is another than
    COLMAP's model shows, `map_again` maps by a copy of the database in `scratch` with the cameras found, and returns
    models, that of most images first. They count unless they have fewer images.
    """
    known = known_of(database, known)
    models = _mapped_as_fisheye(models, database, known, settings, map_again, scratch)
    groups: Groups = []
    found: Outcomes = [_calibrated(model, database, known, settings, progress) for model in models]
    if isinstance(found[0], Apart):
        groups, copy = found[0].groups, scratch / "cameras-apart.db"
        copy_with_cameras(database, copy, groups)
        again = map_again(copy)
        if again and again[0].num_reg_images() >= models[0].num_reg_images():
            models, database = again, copy
            found = [found[0] for _ in models]  # none of these is calibrated
        else:
            groups = []
    if any(isinstance(one, Apart) for one in found):
        known = known_of(database, replace(known, check_shared=False))
        found = [
            _calibrated(model, database, known, settings, progress) if isinstance(one, Apart) else one
            for model, one in zip(models, found, strict=True)
        ]
    if isinstance(found[0], Calibration) and found[0].other_lens:
        models, found = _mapped_again(models, found, database, known, settings, map_again, scratch, progress)
    return models, [one if isinstance(one, Calibration) else None for one in found], groups


def _mapped_again(
    models: Models,
    found: Outcomes,
    database: Path,
    known: Known,
    settings: pycolmap.IncrementalPipelineOptions,
    map_again: MapAgain,
    scratch: Path,
    progress: Progress,
) -> tuple[Models, Outcomes]:
    """Return the models mapped and calibrated by the cameras found, unless these have fewer images then."""
    first = found[0]
    assert isinstance(first, Calibration)
    copy = scratch / "cameras-found.db"
    shutil.copyfile(database, copy)
    _start_from(copy, models[0], first)
    again = map_again(copy)
    if not again or again[0].num_reg_images() < models[0].num_reg_images():
        return models, found
    starts = replace(known, starts=first.freedoms, assumed=frozenset())
    return again, [_calibrated(model, database, starts, settings, progress) for model in again]


def _start_from(database: Path, model: pycolmap.Reconstruction, found: Calibration) -> None:
    with pycolmap.Database.open(database) as opened:
        for camera_id in found.freedoms:
            camera = opened.read_camera(camera_id)
            camera.model = model.cameras[camera_id].model
            camera.params = model.cameras[camera_id].params.tolist()
            opened.update_camera(camera)


def _mapped_as_fisheye(
    models: Models,
    database: Path,
    known: Known,
    settings: pycolmap.IncrementalPipelineOptions,
    map_again: MapAgain,
    scratch: Path,
) -> Models:
    """Return the models, or those that begin with a fisheye's cameras, where wide lenses have left little of a model
    and these hold clearly more."""
    plain = {i: camera for i, camera in known.cameras.items() if camera.model_name == PERSPECTIVE[0][0]}
    wide = [i for i, camera in plain.items() if i not in known.held and may_be_wide(camera)]
    if known.given_model or not wide or _share_mapped(models[0], database, settings) > _LITTLE:
        return models
    copy = scratch / "fisheyes.db"
    shutil.copyfile(database, copy)
    with pycolmap.Database.open(copy) as opened:
        for camera_id in wide:
            camera = opened.read_camera(camera_id)
            params = camera.params.tolist()
            camera.model = pycolmap.CameraModelId.SIMPLE_RADIAL_FISHEYE
            camera.params = [*params[:3], 0.0]
            opened.update_camera(camera)
    again = map_again(copy)
    if not again or again[0].num_reg_images() < models[0].num_reg_images():
        return models
    before, after = (each[0].compute_num_observations() for each in (models, again))
    return again if after > _MORE * before else models


def _share_mapped(
    model: pycolmap.Reconstruction, database: Path, settings: pycolmap.IncrementalPipelineOptions
) -> float:
    """Return the share of the features with verified matches that became observations of a model."""
    graph = _triangulation(model, database, settings).graph
    ids = model.reg_image_ids()
    matched = sum(graph.num_observations_for_image(i) for i in ids)
    return float(sum(model.images[i].num_points3D for i in ids) / max(1, matched))


def _calibrated(
    model: pycolmap.Reconstruction,
    database: Path,
    known: Known,
    settings: pycolmap.IncrementalPipelineOptions,
    progress: Progress,
) -> Calibration | Apart | None:
    return calibrate(model, known, _triangulation(model, database, settings), progress)


def _triangulation(
    model: pycolmap.Reconstruction, database: Path, settings: pycolmap.IncrementalPipelineOptions
) -> Triangulation:
    options = pycolmap.DatabaseCacheOptions(
        min_num_matches=settings.min_num_matches,
        ignore_watermarks=settings.ignore_watermarks,
        image_names={str(model.images[i].name) for i in model.reg_image_ids()},
    )
    with pycolmap.Database.open(database) as opened:
        cache = pycolmap.DatabaseCache.create(opened, options)
    mapper = settings.get_mapper()
    return Triangulation(
        cache.correspondence_graph,
        settings.get_triangulation(),
        mapper.filter_max_reproj_error,
        mapper.filter_min_tri_angle,
        settings.num_threads,
    )
