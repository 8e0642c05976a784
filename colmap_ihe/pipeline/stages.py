"""The stages of the road, each one flat function from a run to what its record says.

A stage reads what the stages before it left in the project and the run, writes its own files, and returns
plain values. It knows nothing of records, resuming or the terminal: that is `pipeline`.
"""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

from colmap_ihe.colmap.database import database_is_sound, remove_database
from colmap_ihe.colmap.features import extract_features
from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.matching import match_features
from colmap_ihe.dense import mesh as surface
from colmap_ihe.dense import textured_mesh as textured
from colmap_ihe.dense.cloud import dense_cloud
from colmap_ihe.errors import MappingError
from colmap_ihe.fit import given_weights as misfit
from colmap_ihe.fit import weights_file
from colmap_ihe.fit.fit_set import Fit, Trial, fit_captures
from colmap_ihe.fit.histogram_file import StoredCounts, write_stored
from colmap_ihe.grey.weights import Weights, grey_from_dict
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.machine.executor import threads_of
from colmap_ihe.machine.files import require_room
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.each import refused
from colmap_ihe.photographs.recipes import recipe_notes, with_recipes
from colmap_ihe.photographs.survey import survey
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.convert import convert_captures, write_masks
from colmap_ihe.pipeline.run_context import Record, RunContext
from colmap_ihe.pipeline.warnings import model as doubts
from colmap_ihe.pipeline.warnings import photographs as oddities
from colmap_ihe.project.options import Options


def captures(run: RunContext, progress: Progress) -> Record:
    cameras, project = run.options.cameras, run.project
    refused_files = refused(run.discovery, run.strict)
    surveyed, left_out = survey(
        run.discovery.captures, run.executor, progress, strict=run.strict, cameras=cameras
    )
    found = with_recipes(
        surveyed,
        run.options.develop,
        project.calibration,
        project.masters,
        run.executor,
        progress,
        strict=run.strict,
    )
    left_out = refused_files | left_out
    run.surveyed = [replace(s, capture=run.kept(s.capture)) for s in found.surveyed]
    recipes = recipe_notes(run.surveyed)
    outputs.remove_masters(project, recipes)
    sizes = Counter((s.metadata.make, s.metadata.model, s.width, s.height) for s in run.surveyed)
    return {
        "images": len(run.surveyed),
        "raw": sum(s.capture.kind == "raw" for s in run.surveyed),
        "paired": {s.capture.name: s.capture.paired for s in run.surveyed if s.capture.paired},
        "with_gps": sum(s.metadata.has_gps for s in run.surveyed),
        "shared_by": oddities.shared_by(run.surveyed),
        "of_one_camera": max(sizes.values()),
        "pixels": sum(s.capture.pixels for s in run.surveyed),
        "largest": max(s.capture.pixels for s in run.surveyed),
        "development": found.steps,
        "recipes": recipes,
        "ignored": list(run.discovery.ignored),
        "left_out": left_out,
        "warnings": [
            *oddities.copies(run.surveyed, run.contents),
            *oddities.odd_sizes(run.surveyed, sizes),
            *oddities.warnings_of(run.surveyed, run.discovery.ignored),
            *found.warnings,
            *oddities.camera_warnings(cameras, run.surveyed, left_out),
        ],
    }


def fit(run: RunContext, progress: Progress) -> Record:
    options = run.options.fit
    trial = trial_of(run.options) if options.measure or options.method == "auto" else None
    given = None if options.weights is None else weights_file.read_weights(run.project.root / options.weights)
    found = fit_captures(
        run.captures(), options, run.executor, progress, strict=run.strict, trial=trial, given=given
    )
    develop = run.options.develop.model_dump(mode="json")
    write_stored(run.project.histogram_file, StoredCounts(found.gathered, options.sample, develop))
    warnings = []
    if len(found.weights) > 1:
        counts = " and ".join(f"{w.images} {encoding}" for encoding, w in found.weights.items())
        warnings.append(
            f"the set mixes {counts} photographs (RAW is linear, JPEG is coded): each kind has weights of its own,"
            " and a colour is not the same grey in both; for one grey use one kind"
        )
    if isinstance(given, Weights):
        warnings += misfit.warnings_of(given, found.gathered[given.encoding], options)
    return {
        "weights": {encoding: w.as_dict() for encoding, w in found.weights.items()},
        "colour_white": found.colour_white,
        "tried": {encoding: t.as_dict() for encoding, t in found.tried.items()},
        "left_out": found.left_out,
        "warnings": warnings,
    }


def trial_of(options: Options) -> Trial:
    """How the photographs will look to COLMAP, for trying greys on them."""
    size = options.features.max_image_size
    return Trial(options.convert.tone) if size is None else Trial(options.convert.tone, size)


def convert(run: RunContext, progress: Progress) -> Record:
    project = run.project
    for half_written in (*project.grey.rglob(".*.tmp"), *project.colour.rglob(".*.tmp")):
        half_written.unlink()
    found = fit_of(run.records["fit"])
    captures_left = {c.name for c in run.captures()}
    surveyed = run.surveyed
    if not surveyed:
        cameras = run.options.cameras
        surveyed, _ = survey(run.captures(), run.executor, progress, strict=run.strict, cameras=cameras)
    grey, left_out = convert_captures(
        [s for s in surveyed if s.capture.name in captures_left],
        found,
        run.options.convert,
        project.grey,
        project.colour,
        run.executor,
        progress,
        strict=run.strict,
        keep_finished=run.resumed,
    )
    warnings = oddities.fit_warnings(run.captures(), found.weights.values())
    warnings += oddities.wallis_warnings(run.options.convert.wallis)
    decoders.end_idle()  # COLMAP, which comes next, has a use for their memory
    return {"grey": grey, "left_out": left_out, "warnings": warnings}


def features(run: RunContext, progress: Progress) -> Record:
    project = run.project
    oddities.require_two([c.name for c in run.captures()], run.contents)
    if not database_is_sound(project.database):
        remove_database(project.database)
    masks, mask_warnings = _masks(run)
    names = run.grey_names()
    counts = extract_features(
        project.database,
        project.grey,
        names,
        masks,
        run.options.camera,
        run.options.features,
        run.records["captures"]["shared_by"],
        project.workspace,
        run.executor,
        progress,
    )
    by_grey = _by_grey(run)
    left_out = {
        by_grey[name]: "COLMAP did not take its grey image; with camera.mode single all need the same size"
        for name in counts.missing
    }
    oddities.require_features(counts.features, counts.images)
    warnings = mask_warnings + oddities.poor_photographs({by_grey[n]: c for n, c in counts.poor.items()})
    if counts.with_focal_prior < counts.images and run.options.camera.params is None:
        warnings.append(
            f"{counts.images - counts.with_focal_prior} of {counts.images} photographs do not say their focal"
            " length: COLMAP guesses it; if you know it, give it in `cameras:` or as camera.params"
        )
    return {
        **asdict(counts),
        "left_out": left_out,
        "warnings": warnings,
    }


def matches(run: RunContext, progress: Progress) -> Record:
    project = run.project
    images = run.records["features"]["images"]
    try:
        counts = match_features(
            project.database,
            project.workspace,
            run.options.matches,
            images,
            run.records["captures"]["with_gps"],
            run.executor,
            progress,
        )
    except MappingError as error:
        said, hint = doubts.why_no_match(project.database, _by_grey(run), images)
        raise MappingError(said, hint) from error
    return {
        **asdict(counts),
        "warnings": doubts.match_warnings(counts.found_again),
    }


def sparse(run: RunContext, progress: Progress) -> Record:
    project, by_grey = run.project, _by_grey(run)
    images = run.records["features"]["images"]
    try:
        models = map_images(
            project.database, project.grey, project.sparse, run.options.sparse, images, progress
        )
    except MappingError as error:
        said, hint = doubts.why_no_model(project.database, images)
        raise MappingError(said, hint) from error
    missing = sorted(by_grey[n] for n in run.grey_names() if n not in models[0].image_names)
    warnings = doubts.model_warnings(models, project.sparse, project.database, by_grey, missing)
    return {"models": [asdict(m) for m in models], "unregistered": missing, "warnings": warnings}


def _by_grey(run: RunContext) -> dict[str, str]:
    """Photographs by the names of their grey images."""
    return {grey: name for name, grey in run.records["convert"]["grey"].items()}


def dense(run: RunContext, progress: Progress) -> Record:
    project = run.project
    there = outputs.bytes_of("dense", project)
    return dense_cloud(
        project.sparse / "0",
        project.grey,
        project.colour,
        project.made_masks,
        project.dense,
        run.options.dense,
        run.executor,
        progress,
        lambda wanted: require_room(project.root, wanted - there),
    )


def mesh(run: RunContext, progress: Progress) -> Record:
    project, options = run.project, run.options.mesh
    try:
        made = surface.reconstruct_surface(
            project.dense / "fused.ply",
            project.mesh,
            options.faces,
            options=options.colmap,
            progress=progress,
        )
    except MappingError as error:  # the cloud is there all the same
        return {"files": [], "warnings": [f"no mesh was made: {error}"]}
    record = {**asdict(made), "files": [project.mesh.name], "warnings": []}
    if options.texture is False:
        return record
    with threads_of(run.executor) as threads:  # each looks at all of the mesh
        texture = textured.texture_mesh(
            project.dense, project.mesh, options.texture_size, executor=threads, progress=progress
        )
    return {**record, "texture": asdict(texture), "files": [project.mesh.name, *textured.FILES]}


def _masks(run: RunContext) -> tuple[Path | None, list[str]]:
    """COLMAP's mask folder for the grey images, made of the user's masks; None if there are none."""
    project, made = run.project, run.project.made_masks
    shutil.rmtree(made, ignore_errors=True)
    if not project.masks.is_dir():
        return None, []
    used = write_masks(project.masks, run.records["convert"]["grey"], project.grey, made)
    found = {p.relative_to(project.masks).as_posix() for p in project.masks.rglob("*.png")}
    unused = sorted(found - used)
    if not unused:
        return made, []
    return made, [
        f"{len(unused)} masks belong to no photograph, as masks/{unused[0]}: IMG.JPG has IMG.JPG.png"
    ]


def fit_of(record: Record) -> Fit:
    """The fit that a record of the stage holds."""
    weights = [grey_from_dict(w, "records/fit.json") for w in record["weights"].values()]
    return Fit({w.encoding: w for w in weights}, record["colour_white"])


def write_weights(run: RunContext) -> None:
    """report/weights.yaml, which `convert --weights` reads."""
    weights_file.write_weights(run.project.weights_file, fit_of(run.records["fit"]).main)
