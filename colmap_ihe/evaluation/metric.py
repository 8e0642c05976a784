"""Measure a model of a comparison by the survey of its project: how far control and check points are off."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import ControlFileError
from colmap_ihe.pipeline.given_control import control_digests, dictionary_for, given_control, named_control
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.survey.accuracy import point_rms
from colmap_ihe.survey.alignment import Survey
from colmap_ihe.survey.control import Control
from colmap_ihe.survey.georeference import georeference
from colmap_ihe.survey.target_observations import targets_of_set

_PRINCIPAL_POINT = ("cx", "cy")


@dataclass(frozen=True)
class GivenSurvey:
    """Hold what the control/ of a project says, for all methods alike, and the digests of its files by name."""

    control: Control
    digests: dict[str, str]
    options: Options
    executor: Executor

    def inputs(self) -> tuple[Any, ...]:
        """Return what figures depend on, as plain values; nothing without control."""
        if not self.digests:
            return ()
        return (sorted(self.digests.items()), self.options.survey.model_dump(mode="json"))

    def figures_of(self, greys: Path, grey_of: Mapping[str, str], folder: Path) -> dict[str, float]:
        """Return `check_rms_mm`, `control_rms_mm` and `extent_m`, the diagonal of its points without the outermost, of
        the model in `folder`; nothing that the survey does not tell. `greys`: the folder of the method's grey images,
        `grey_of`: these by the names of their photographs."""
        if not self.digests:
            return {}
        model = pycolmap.Reconstruction(folder)
        cameras = {
            str(model.images[i].name): model.cameras[model.images[i].camera_id] for i in model.reg_image_ids()
        }
        sizes = {name: (camera.width, camera.height) for name, camera in cameras.items()}
        named = named_control(self.control, grey_of, sizes)
        sights = list(named.observations)
        if dictionary := dictionary_for(self.control, self.options):
            sights += targets_of_set(model, greys, self.executor, dictionary).observations
        control = named.control
        survey = Survey(control.points, bars=control.scale_bars, positions=control.positions, crs=control.crs)
        try:
            result = georeference(model, survey, sights, self.options.survey.align, _free(model))
        except ControlFileError:
            return {}
        if not result.method:
            return {}
        values = {role: point_rms(result.points, role) for role in ("check", "control")}
        figures = {f"{role}_rms_mm": 1000 * value for role, value in values.items() if value is not None}
        return figures | {"extent_m": _extent_m(model)}


def given_survey(project: Project, options: Options, executor: Executor) -> GivenSurvey:
    """Return the survey of a project. Raises `ControlFileError` and `OptionError` for what cannot be used."""
    return GivenSurvey(given_control(project, options), control_digests(project, options), options, executor)


def _free(model: pycolmap.Reconstruction) -> dict[int, list[int]]:
    """Return by camera the parameters that are adjusted: all but the principal point, for all methods alike."""
    return {
        number: [
            place for place, name in enumerate(camera.params_info.split(", ")) if name not in _PRINCIPAL_POINT
        ]
        for number, camera in model.cameras.items()
    }


def _extent_m(model: pycolmap.Reconstruction) -> float:
    points = np.array([point.xyz for point in model.points3D.values()])
    low, high = np.percentile(points, (1, 99), axis=0)
    return float(np.linalg.norm(high - low))
