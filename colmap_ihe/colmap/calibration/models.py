"""Calibrate the models of a mapping, and map once more where by COLMAP's camera model it misplaced images."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from colmap_ihe.colmap.calibration.calibrate import Apart, Calibration, Known, calibrate
from colmap_ihe.colmap.calibration.choose import may_be_wide
from colmap_ihe.colmap.calibration.explained import least_explained
from colmap_ihe.colmap.calibration.freedom import PERSPECTIVE
from colmap_ihe.colmap.calibration.lens import fitted
from colmap_ihe.colmap.calibration.rebuild import Triangulation
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.part_databases import copy_with_cameras
from colmap_ihe.errors import NativeError
from colmap_ihe.machine.progress import SILENT, Progress

Models: TypeAlias = "list[pycolmap.Reconstruction]"
Outcomes = Sequence[Calibration | Apart | None]
MapAgain = Callable[[Path], Models]

_LITTLE = 0.25
"""Share of matched features in a model below which mapping failed: 0.02 to 0.24 where it did, of simulated fisheyes,
0.3 to 0.9 elsewhere (0.45 of strangers' photographs)."""
_EXPLAINED = 0.9
"""Least share of an image's matches that agree with its place where all are in place: .995 or more on simulated
lenses, .99 of sceaux, .95 of strangers' photographs; .56 to .81 where mapping had misplaced images by decimetres."""
_MORE = 1.5  # times the observations, for a model that began otherwise


@dataclass(frozen=True)
class Setting:
    """Hold what models are calibrated with: the database, what is known of its cameras, COLMAP's options of points,
    `map_again`, which maps by a copy of the database in `scratch` and returns models, that of most images first, and
    what went wrong (`problems`), for the user."""

    database: Path
    known: Known
    options: pycolmap.IncrementalPipelineOptions
    map_again: MapAgain
    scratch: Path
    progress: Progress = SILENT
    problems: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Calibrated:
    """Hold models, what came of the calibration of each, and the images by name in groups of one camera each, where a
    camera was only assumed to have taken them all and clearly had not."""

    models: Models
    calibrations: list[Calibration | None]
    apart: list[list[str]]


def known_of(database: Path, known: Known) -> Known:
    """Return what is known with the cameras of a database. Those without a focal length from EXIF are only assumed to
    have taken all their images, if that is to be checked."""
    with pycolmap.Database.open(database) as opened:
        cameras = {int(camera.camera_id): camera for camera in opened.read_all_cameras()}
    unproved = frozenset(i for i, camera in cameras.items() if not camera.has_prior_focal_length)
    return replace(
        known, cameras=cameras, assumed=unproved - known.held if known.check_shared else frozenset()
    )


def calibrate_models(models: Models, given: Setting) -> Calibrated:
    """Return the models with their cameras calibrated. Where a camera did not take all its images, or images were lost
    or misplaced, they are mapped once more with other cameras, which counts unless fewer images are registered. What
    fails on the way is told as one of the problems, and the models are left as they were before."""
    given = replace(given, known=known_of(given.database, given.known))
    models = _mapped_as_fisheye(models, given)
    groups: list[list[str]] = []
    found: Outcomes = [_calibrated(model, given) for model in models]
    if isinstance(found[0], Apart):
        copy = given.scratch / "cameras-apart.db"
        copy_with_cameras(given.database, copy, found[0].groups)
        again = _mapped_again(models, given, copy, "a camera for each focal length found")
        if again:
            models, groups, given = again, found[0].groups, replace(given, database=copy)
            found = [found[0] for _ in models]  # none of these is calibrated
    if any(isinstance(one, Apart) for one in found):
        given = replace(given, known=known_of(given.database, replace(given.known, check_shared=False)))
        found = [
            _calibrated(model, given) if isinstance(one, Apart) else one
            for model, one in zip(models, found, strict=True)
        ]
    first = found[0]
    if isinstance(first, Calibration) and (first.other_lens or _explained(models[0], given) <= _EXPLAINED):
        models, found = _by_the_lens_found(models, found, first, given)
    return Calibrated(models, [one if isinstance(one, Calibration) else None for one in found], groups)


def _mapped_again(models: Models, given: Setting, copy: Path, cameras: str) -> Models:
    """Return models by a copy of the database with other `cameras`, in words; none where these have fewer images, or
    COLMAP fails, which is told."""
    try:
        again = given.map_again(copy)
    except NativeError as error:
        given.problems.append(
            f"mapping once more with {cameras} failed, and the first model is kept: {error}"
        )
        return []
    return again if again and again[0].num_reg_images() >= models[0].num_reg_images() else []


def _by_the_lens_found(
    models: Models, found: Outcomes, first: Calibration, given: Setting
) -> tuple[Models, Outcomes]:
    """Return the models calibrated from the cameras found on. Where the first mapping left images out or misplaced
    some, they are mapped again before: wide lenses begun as fisheyes, since what was found of them comes of places that
    are wrong, and if that does not mend it by the cameras found. The mapping that explains most counts."""
    anew = replace(given, known=replace(given.known, assumed=frozenset()))
    starts = replace(anew, known=replace(anew.known, starts=first.freedoms))
    if _in_place(models[0], given) == 1:
        further = [_calibrated(model, starts) for model in models]
        # How they compare with COLMAP's, which is no longer known, is as before.
        return models, [
            replace(second, gain=one.gain)
            if isinstance(second, Calibration) and isinstance(one, Calibration)
            else one
            for one, second in zip(found, further, strict=True)
        ]
    tries = [(models, found)]
    lens = given.scratch / "cameras-found.db"
    shutil.copyfile(given.database, lens)
    _start_from(lens, models[0], first)
    for copy, known, cameras in (
        (_begun_as_fisheyes(given), anew, "the camera of a fisheye"),
        (lens, starts, "the lens that was found"),
    ):
        again = _mapped_again(models, given, copy, cameras) if copy else []
        if again:
            tries.append((again, [_calibrated(model, known) for model in again]))
            if _in_place(again[0], given) == 1:
                break
    return max(tries, key=lambda one: _in_place(one[0][0], given))


def _in_place(model: pycolmap.Reconstruction, given: Setting) -> float:
    """Return 1 where all images of the database are registered and the matches of each agree with where it is, and less
    the more are not."""
    with pycolmap.Database.open(given.database) as opened:
        registered = model.num_reg_images() / opened.num_images()
    share = _explained(model, given)
    return registered * (1 if share > _EXPLAINED else share)


def _explained(model: pycolmap.Reconstruction, given: Setting) -> float:
    triangulation = _triangulation(model, given)
    return least_explained(model, triangulation.graph, triangulation.most_error_px)


def _start_from(database: Path, model: pycolmap.Reconstruction, found: Calibration) -> None:
    with pycolmap.Database.open(database) as opened:
        for camera_id in found.freedoms:
            camera, lens = opened.read_camera(camera_id), model.cameras[camera_id]
            if lens.model_name == PERSPECTIVE[-1][0]:  # whose denominator the mapper frees, and loses images
                lens = fitted(lens, *PERSPECTIVE[-2])
            camera.model, camera.params = lens.model, lens.params.tolist()
            opened.update_camera(camera)


def _mapped_as_fisheye(models: Models, given: Setting) -> Models:
    """Return the models, or those that begin with a fisheye's cameras, where wide lenses have left little of a model
    and these hold clearly more."""
    copy = _begun_as_fisheyes(given) if _share_mapped(models[0], given) <= _LITTLE else None
    again = _mapped_again(models, given, copy, "the camera of a fisheye") if copy else []
    if not again:
        return models
    before, after = (each[0].compute_num_observations() for each in (models, again))
    return again if after > _MORE * before else models


def _begun_as_fisheyes(given: Setting) -> Path | None:
    """Return a copy of the database whose lenses begin as fisheyes where they may be; None where none may."""
    known = given.known
    plain = {i: camera for i, camera in known.cameras.items() if camera.model_name == PERSPECTIVE[0][0]}
    wide = [i for i, camera in plain.items() if i not in known.held and may_be_wide(camera)]
    if known.given_model or not wide:
        return None
    copy = given.scratch / "fisheyes.db"
    shutil.copyfile(given.database, copy)
    with pycolmap.Database.open(copy) as opened:
        for camera_id in wide:
            camera = opened.read_camera(camera_id)
            params = camera.params.tolist()
            camera.model = pycolmap.CameraModelId.RADIAL_FISHEYE
            camera.params = [*params[:3], 0.0, 0.0]
            opened.update_camera(camera)
    return copy


def _share_mapped(model: pycolmap.Reconstruction, given: Setting) -> float:
    """Return the share of the features with verified matches that became observations of a model."""
    graph = _triangulation(model, given).graph
    ids = model.reg_image_ids()
    matched = sum(graph.num_observations_for_image(i) for i in ids)
    return float(sum(model.images[i].num_points3D for i in ids) / max(1, matched))


def _calibrated(model: pycolmap.Reconstruction, given: Setting) -> Calibration | Apart | None:
    try:
        return calibrate(model, given.known, _triangulation(model, given), given.progress)
    except np.linalg.LinAlgError as error:
        given.problems.append(
            "cameras are left as COLMAP has them: the equations of their calibration have no solution"
            f" ({error}). sparse.calibration=colmap does without, camera.calibration takes one that is known"
        )
        return None


def _triangulation(model: pycolmap.Reconstruction, given: Setting) -> Triangulation:
    settings = given.options
    options = pycolmap.DatabaseCacheOptions(
        min_num_matches=settings.min_num_matches,
        ignore_watermarks=settings.ignore_watermarks,
        image_names={str(model.images[i].name) for i in model.reg_image_ids()},
    )
    with pycolmap.Database.open(given.database) as opened:
        cache = pycolmap.DatabaseCache.create(opened, options)
    mapper = settings.get_mapper()
    return Triangulation(
        cache.correspondence_graph,
        settings.get_triangulation(),
        mapper.filter_max_reproj_error,
        mapper.filter_min_tri_angle,
        settings.num_threads,
    )
