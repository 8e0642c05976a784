"""Sum up a project from the records of its stages, and write its page again from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.calibration.held_out import HeldOut
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.files import read_json
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.pipeline.page import write_page
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stage import Record, RunContext
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.pipeline.stages.sparse import STAGE as SPARSE
from colmap_ihe.pipeline.survey_records import survey_summary
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import project_options


def summarise(records: Mapping[str, Mapping[str, Any]], options: Options) -> dict[str, Any]:
    """Return what report/summary.json holds; a value is None where its stage has not run.

    `weights` are those of the kind of photograph (gamma-coded or linear) that most are of;
    `weights_by_encoding` holds all. `tried` is what was measured against COLMAP's default grey. `too_few_registered`
    says that the run ended early, and not as a success.
    """
    by_encoding = records["fit"]["weights"] if "fit" in records else {}
    main = max(by_encoding.values(), key=lambda w: int(w["images"]), default=None)
    later = ("features", "matches", "sparse", "survey", "dense", "mesh")
    features, matches, sparse, survey, dense, mesh = (records.get(stage, {}) for stage in later)
    colour = records.get("convert", {}).get("second")
    models = sparse.get("models", [])
    model = models[0] if models else {}
    with_depth = 100 * dense["pixels_with_depth"] / dense["pixels"] if dense.get("pixels") else None
    left_out = {name: why for r in records.values() for name, why in r.get("left_out", {}).items()}
    shortfall = SPARSE.shortfall(options, dict(sparse)) if sparse else None
    return {
        "images": records["captures"]["images"] + len(records["captures"]["left_out"]),
        "left_out": left_out,
        "registered_images": model.get("registered_images"),
        "unregistered": sparse.get("unregistered"),
        "too_few_registered": shortfall is not None if sparse else None,
        "models": [m["registered_images"] for m in models] or None,
        "method": options.fit.method,
        "weights": main["weights"] if main else None,
        "score": main["score"] if main else None,
        "tones": main["tones"] if main else None,
        "tried": records["fit"]["tried"].get(main["encoding"]) if main else None,
        "colour_detail_lost_percent": (
            {"grey": 100 * colour["lost"], "rec709": 100 * colour["lost_by_rec709"]} if colour else None
        ),
        "second_grey": _second(colour, features) if colour and colour["second"] else None,
        "weights_by_encoding": {e: w["weights"] for e, w in by_encoding.items()},
        "cameras": [_camera(camera, survey) for camera in sparse.get("cameras", ())] or None,
        "held_out_error_px": _held_out(sparse.get("held_out")),
        "with_focal_prior": features.get("with_focal_prior"),
        "features": features.get("features"),
        "matching": matches.get("strategy"),
        "pairs_verified": matches.get("pairs_verified"),
        "inlier_matches": matches.get("inliers"),
        "points3D": model.get("points3d"),
        "points_over_3_views": model.get("points_over_3_views"),
        "mean_track_length": model.get("mean_track_length"),
        "mean_reprojection_error_px": model.get("mean_reprojection_error_px"),
        **survey_summary(survey),
        "dense_points": dense.get("points"),
        "dense_backend": dense.get("backend"),
        "dense_pixels_with_depth_percent": with_depth,
        "mesh_faces": mesh.get("faces"),
        "mesh_texture": [mesh["texture"]["width"], mesh["texture"]["height"]] if "texture" in mesh else None,
        "stages": {name: record["seconds"] for name, record in records.items()},
        "peak_memory_bytes": max(record.get("peak_memory_bytes", 0) for record in records.values()) or None,
        "page_seconds": None,
        "warnings": [
            *(text for record in records.values() for text in record["warnings"]),
            *([f"{shortfall.reason} ({shortfall.hint})"] if shortfall else []),
        ],
    }


def _second(record: Mapping[str, Any], features: Mapping[str, Any]) -> dict[str, Any]:
    """Return the second grey, with its features and the share that it shows of what the first loses."""
    second = record["second"]
    return {
        "weights": [second[name] for name in ("red", "green", "blue")],
        "name": second["name"],
        "shown_percent": 100 * record["regained"] / record["lost"] if record["lost"] else 0.0,
        "features": features.get("of_second"),
    }


def _is_measured(value: object) -> bool:
    """Tell whether a value of the section `truth` is a number, or numbers by name."""
    return all(type(v) in (int, float) for v in (value.values() if isinstance(value, dict) else [value]))


def _camera(record: Mapping[str, Any], survey: Mapping[str, Any]) -> dict[str, Any]:
    camera_id = str(record["camera_id"])
    deviations = survey.get("camera_deviations", {}).get(camera_id, record["standard_deviations"])
    adjusted = survey.get("camera_params", {}).get(camera_id, record["params"])
    return {
        **{name: record[name] for name in ("model", "width", "height", "photographs", "by")},
        "parameters": dict(zip(record["names"], adjusted, strict=True)),
        "standard_deviations": dict(zip(record["names"], deviations, strict=True)) if deviations else None,
        "doubtful": record["correlated"],
        "exif": record.get("exif"),
    }


def _held_out(record: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if record is None:
        return None
    gain = HeldOut(record["colmap_px"], record["calibrated_px"], record["standard_errors"])
    return {"colmap": gain.colmap_px, "calibrated": gain.chosen_px, "confirmed": not gain.worse}


def report(
    project: Path,
    assignments: Sequence[str] = (),
    images: Path | None = None,
    progress: RunProgress = SILENT,
) -> Path:
    """Write report/index.html of a project again, from what its stages left, and return it. Raises
    `KnownError`s; `ProjectError` where nothing is converted yet."""
    options, folder = project_options(project, list(assignments)), Project.at(project, images)
    records: dict[str, Record] = {}
    for stage in STAGES:
        record = None if stage.switched_off(options) else read_record(folder, stage.name)
        if record is None:
            break
        records[stage.name] = record
    if "convert" not in records:
        raise ProjectError(
            f"{project}: no photograph is converted yet, so there is nothing to show",
            hint="run `colmap-ihe reconstruct` first",
        )
    summary = summarise(records, options)
    truth = (read_json(folder.summary_file) or {}).get("truth")  # of this very model, else it were gone
    if isinstance(truth, dict) and all(map(_is_measured, truth.values())):
        summary["truth"] = truth
    with folder.locked(), local_executor() as executor, progress.stage("page") as stage_progress:
        run = RunContext(folder, options, find_photographs(folder.images), executor, records=records)
        return write_page(run, summary, stage_progress, progress.warn)
