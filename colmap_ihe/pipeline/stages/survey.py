"""Survey: bring the model into metres, adjust it with control, and tell how well it agrees."""

from __future__ import annotations

import shutil
from collections.abc import Container, Mapping
from dataclasses import replace
from pathlib import Path

from colmap_ihe.colmap.gps_fixes import useful_fixes
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.files import replace_folder, write_json
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.photographs.exif.xmp import rtk_position
from colmap_ihe.pipeline.given_control import control_digests, dictionary_for, given_control, named_control
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Record, RunContext, Stage
from colmap_ihe.pipeline.survey_records import SurveyRecord, georeference_json, survey_record
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.survey.adjustment import MOST_IMAGES
from colmap_ihe.survey.alignment import Survey
from colmap_ihe.survey.control import CameraPosition
from colmap_ihe.survey.frames import GPS
from colmap_ihe.survey.georeference import georeference
from colmap_ihe.survey.target_observations import (
    BYTES_A_PIXEL,
    SetTargets,
    left_out_in_words,
    targets_of_set,
)

_PAIR_OF_IMAGES = 1200  # bytes: four matrices of six unknowns an image, in double precision
_MODEL = ("cameras.bin", "images.bin", "points3D.bin")


def run(run: RunContext, progress: Progress) -> SurveyRecord:
    """Align and adjust the largest model, and write it as workspace/metric; nothing where nothing says its scale."""
    project, options = run.project, run.options
    control = given_control(project, options)
    if options.survey.align == "none":
        return SurveyRecord(method="", warnings=[])
    model = pycolmap.Reconstruction(project.sparse / "0")
    images = {str(model.images[i].name): model.images[i] for i in model.reg_image_ids()}
    cameras = {name: model.cameras[image.camera_id] for name, image in images.items()}
    sizes = {name: (camera.width, camera.height) for name, camera in cameras.items()}
    named = named_control(control, run.records["convert"]["grey"], sizes)
    targets = SetTargets((), {})
    if dictionary := dictionary_for(control, options):
        targets = targets_of_set(model, project.grey, run.executor, dictionary, progress)
    clicked = {observation.name for observation in named.observations}
    seen = [*named.observations, *(o for o in targets.observations if o.name not in clicked)]
    survey = Survey(
        points=named.control.points,
        bars=named.control.scale_bars,
        positions=named.control.positions,
        fixes=_fixes(project, images),
        fix_accuracy_m=options.survey.gps_accuracy_m,
        crs=named.control.crs,
    )
    if not control.coordinates():
        survey = replace(survey, positions=_rtk_positions(run, images), crs=GPS)
    result = georeference(model, survey, seen, options.survey.align, _free(run.records["sparse"]), progress)
    record = survey_record(result, run.photographs_by_grey())
    record.targets = len({observation.name for observation in targets.observations})
    told = (
        left_out_in_words(targets, result.triangulated)
        if targets.observations and result.triangulated
        else []
    )
    record.warnings = [*named.warnings, *told, *record.warnings, *_missing(record)]
    if result.method:
        record.camera_params = {str(i): list(map(float, c.params)) for i, c in model.cameras.items()}
        _write(project, model, record)
    return record


def _fixes(project: Project, images: Mapping[str, pycolmap.Image]) -> dict[str, tuple[float, float, float]]:
    """Return longitude, latitude and height of registered images, by name."""
    fixes = useful_fixes(project.database)
    return {
        name: (fixes[image.image_id][1], fixes[image.image_id][0], fixes[image.image_id][2])
        for name, image in images.items()
        if image.image_id in fixes
    }


def _rtk_positions(run: RunContext, images: Container[str]) -> list[CameraPosition]:
    """Return where drones with RTK stood when they took registered photographs, in degrees."""
    greys = run.records["convert"]["grey"]
    found = {
        greys[c.name]: rtk_position(c.path) for c in run.discovery.captures if greys.get(c.name) in images
    }
    return [
        CameraPosition(grey, (rtk.longitude, rtk.latitude, rtk.height_m), rtk.accuracy_m)
        for grey, rtk in sorted(found.items())
        if rtk is not None
    ]


def _free(sparse: Record) -> dict[int, list[int]]:
    """Return by camera the parameters that mapping and calibration have left free, by their places."""
    free = {}
    for camera in sparse["cameras"]:
        deviations = camera["standard_deviations"]
        if camera["by"] == "given":
            places = []
        elif deviations:
            places = [n for n, deviation in enumerate(deviations) if deviation]
        else:
            places = [n for n, name in enumerate(camera["names"]) if name not in ("cx", "cy")]
        free[camera["camera_id"]] = places
    return free


def _missing(record: SurveyRecord) -> list[str]:
    """Name the surveyed points that have no place in the model."""
    missing = [f"{p.name} ({p.reason})" for p in record.points if p.role != "seen" and p.delta_m is None]
    lost = [p for p in missing if "left out" not in p]
    if not lost or not record.method:
        return []
    more = f" and {len(lost) - 4} more" if len(lost) > 4 else ""
    return [f"surveyed points without a place in the model: {'; '.join(lost[:4])}{more}"]


def _write(project: Project, model: pycolmap.Reconstruction, record: SurveyRecord) -> None:
    temporary = project.metric.with_name(f".{project.metric.name}.new")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    model.write(temporary)
    replace_folder(temporary, project.metric)
    write_json(project.georeference_file, georeference_json(record))


def _inputs(
    project: Project, options: Options, discovery: object, known: object
) -> dict[str, dict[str, str]]:
    digests = control_digests(project, options)
    return {"control": digests} if digests else {}


def _files(project: Project, record: Record) -> list[Path]:
    if not record["method"]:
        return []
    return [*(project.metric / name for name in _MODEL), project.georeference_file]


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    equations = _PAIR_OF_IMAGES * min(size.images, MOST_IMAGES) ** 2
    return StageNeeds("survey", BASE_BYTES + equations, BYTES_A_PIXEL * size.largest, 0)


def _parts(options: Options, known: Known) -> list[Part]:
    return [Part("survey", "adjustments with control", 0.02 * known.images)]


STAGE = Stage(
    "survey",
    run,
    SurveyRecord,
    sections=("survey",),
    libraries=("pycolmap", "opencv", "numpy"),
    inputs=_inputs,
    files=_files,
    made=lambda project: [project.metric, project.georeference_file, *project.workspace.glob(".metric.*")],
    needs=_needs,
    parts=_parts,
)
