"""Evaluate several greys on the photographs of one project, side by side, as the paper does.

Each method has a project of its own below `compare/`, which resumes as any other: photographs are converted, features
found and matched once a method. The mapper runs with all matches, and once a seed without some of them, which shows how
much is chance. Dense stereo runs once a method, with the cameras of the first for all: only the grey differs. One
method alone has a second grey, and is left out where the photographs need none.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.calibration.calibrate import Known
from colmap_ihe.colmap.database import remove_database
from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.measures import rms_px, thin_out
from colmap_ihe.colmap.native import logged_to
from colmap_ihe.dense.cloud import dense_cloud
from colmap_ihe.errors import MappingError
from colmap_ihe.evaluation.figures import errors_against, matching_of, plain_truth, read_pairs, truth_of
from colmap_ihe.evaluation.method_projects import check_names, options_of, project_of
from colmap_ihe.evaluation.metric import GivenSurvey, given_survey
from colmap_ihe.evaluation.page import command_of, write_comparison
from colmap_ihe.evaluation.tables import LEFT_OUT, METHODS, SECOND, MethodResult, tables_of
from colmap_ihe.evaluation.truth import Truth
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.files import (
    fingerprint_of,
    read_json,
    require_room,
    write_bytes,
    write_json,
)
from colmap_ihe.machine.libraries import library_versions
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.machine.threads import limited
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.pipeline.given_calibration import given_calibration, held_cameras
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.second_grey import second_of
from colmap_ihe.pipeline.stages.sparse import are_too_few
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_Row = dict[str, Any]


def compare(
    project: str | Path,
    options: Options | None = None,
    *,
    methods: Sequence[str] = METHODS,
    seeds: int = 3,
    pairs: str | Path | None = None,
    images: str | Path | None = None,
    progress: RunProgress = SILENT,
) -> list[MethodResult]:
    """Measure each of `methods` on the photographs of a project; what was measured before is not measured again.

    `pairs` is a file of two photographs a line, in which matching is measured instead of in all pairs. Truth is read
    from PROJECT/truth, or from `gt` beside the photographs. Raises `KnownError`s, among them `OptionError` for an
    unknown method, and `Cancelled`.
    """
    options = options or Options()
    check_names(methods)
    compared = Project.at(Path(project), Path(images) if images else None)
    calibration = given_calibration(compared, options)
    truth = truth_of(compared)
    chosen = _chosen(compared, pairs)
    common = Project.at(compared.comparison, compared.images)
    developed = common.root / "developed"  # RAW photographs, developed once for all methods
    results: list[MethodResult] = []
    reconstructions: list[Reconstruction] = []
    with ExitStack() as stack:
        stack.enter_context(common.locked())
        stack.enter_context(logged_to(common.native_log))
        stack.enter_context(limited(options.machine.threads))
        executor = stack.enter_context(local_executor())
        survey = given_survey(compared, options, executor)
        for method in dict.fromkeys(methods):
            own = options_of(method, options)
            advance = partial(
                reconstruct,
                project_of(compared, common, method, own, calibration).root,
                own,
                images=compared.images,
                progress=progress,
                executor=executor,
                developed=developed,
            )
            if method == SECOND and not _has_second(advance, own):
                continue
            done = advance(until="matches")
            runs = {seed: _mapped(done, options, seed, truth, survey, progress) for seed in range(seeds + 1)}
            if not results:
                _require_cameras(method, int(runs[0]["registered"]), _images_of(done), options)
            reconstructions.append(done)
            cameras = _seed_folder(reconstructions[0], 0) / "0"
            matching = matching_of(done.project, cameras, chosen)
            points = _dense_points(done, reconstructions[0], options, executor, progress)
            weights, second = done.summary["weights"], done.summary["second_grey"]
            results.append(MethodResult(method, weights and tuple(weights), matching, runs, points, second))
        shutil.rmtree(developed, ignore_errors=True)
        _require_results(results)
        _write(common.root, results)
        command = command_of(compared.root, options, results, pairs=pairs, images=images)
        write_comparison(compared, results, [done.project for done in reconstructions], cameras, command)
    return results


def _chosen(compared: Project, pairs: str | Path | None) -> Collection[frozenset[str]] | None:
    """Return the pairs in which matching is measured, None for all. Raises `KnownError`s for a file of others."""
    if not pairs:
        return None
    return read_pairs(Path(pairs), [c.name for c in find_photographs(compared.images).captures])


def _require_results(results: Sequence[MethodResult]) -> None:
    if not results:
        raise MappingError(
            f"{SECOND}: the photographs need no second grey, and no other method was named",
            hint="name another method too, or take a direction by --set fit.second=red",
        )


def _has_second(advance: Callable[..., Reconstruction], options: Options) -> bool:
    """Tell whether there is a second grey; if it is sought, the photographs are converted by `advance`."""
    if options.fit.second == "none":
        return False
    return advance(until="convert").summary["second_grey"] is not None


def _require_cameras(method: str, registered: int, images: int, options: Options) -> None:
    if not registered:
        raise MappingError(
            f"{method}: no photograph is registered in its model, whose cameras all methods would use",
            hint="name another method first",
        )
    if are_too_few(registered, images, options):
        raise MappingError(
            f"{method}: only {registered} of {images} photographs are registered in its model, whose cameras all"
            " methods would use",
            hint="name another method first, or compare all the same by --set sparse.min_registered=0",
        )


def _images_of(done: Reconstruction) -> int:
    """Count the photographs that could be used."""
    return int(done.summary["images"]) - len(done.summary["left_out"])


def _write(folder: Path, results: Sequence[MethodResult]) -> None:
    write_json(folder / "compare.json", [asdict(result) for result in results])
    for table in tables_of(results):
        write_bytes(folder / f"{table.name}.csv", table.as_csv().encode())
        write_bytes(folder / f"{table.name}.tex", table.as_latex().encode())


def _seed_folder(done: Reconstruction, seed: int) -> Path:
    return done.project.workspace / "seeds" / str(seed)


def _mapped(
    done: Reconstruction,
    options: Options,
    seed: int,
    truth: Truth | None,
    survey: GivenSurvey,
    progress: RunProgress,
) -> Mapping[str, float]:
    """Return the figures of one run of the mapper: with all matches for seed 0, else without some."""
    project, folder = done.project, _seed_folder(done, seed)
    name = f"{project.root.name}, run {seed}"
    images = _images_of(done)
    held = held_cameras(project, options, read_record(project, "features") or {})

    def measure() -> _Row:
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        database = project.database
        if seed:
            database = folder.with_name(f"{seed}.db")
            thin_out(project.database, database, LEFT_OUT, seed)
        try:
            with progress.stage(name) as stage_progress:
                mapped = map_images(
                    database,
                    project.grey,
                    folder,
                    options.sparse,
                    images,
                    stage_progress,
                    known=Known(held=held),
                    on_second_try=lambda each: progress.warn(f"{name}: {each.in_words()}"),
                )
                model = mapped.models[0]
        except MappingError as error:
            progress.warn(f"{name}: {error}")
            return {"registered": 0, "points": 0, "points_over_3_views": 0}
        finally:
            if seed:
                remove_database(database)
        row: _Row = {
            "registered": model.registered_images,
            "points": model.points3d,
            "points_over_3_views": model.points_over_3_views,
            "mean_error_px": model.mean_reprojection_error_px,
            "rms_px": rms_px(folder / "0"),
        }
        row |= survey.figures_of(project.grey, (read_record(project, "convert") or {})["grey"], folder / "0")
        return row | (errors_against(truth, folder / "0") if truth else {})

    sparse = options.sparse.model_dump(mode="json", exclude={"min_registered"})
    more = (*((sorted(held),) if held else ()), *survey.inputs())
    return _once(project, f"run-{seed}", measure, sparse, LEFT_OUT, plain_truth(truth), *more)


def _dense_points(
    done: Reconstruction, first: Reconstruction, options: Options, executor: Executor, progress: RunProgress
) -> int | None:
    """Return the points of the dense cloud of a method with the cameras of the first; None without dense stereo."""
    if not options.dense.enabled:
        return None
    project = done.project
    cameras, dense = _seed_folder(first, 0) / "0", project.workspace / "same-cameras"

    def measure() -> _Row:
        shutil.rmtree(dense, ignore_errors=True)
        with progress.stage(f"{project.root.name}, dense") as stage_progress:
            cloud = dense_cloud(
                cameras,
                project.grey,
                project.colour,
                project.made_masks,
                dense,
                options.dense,
                executor,
                stage_progress,
                partial(require_room, project.root),
                second_of({"convert": read_record(project, "convert") or {}}),
            )
        (dense / "fused.ply").replace(project.workspace / "same-cameras.ply")
        shutil.rmtree(dense)
        return {"points": cloud["points"]}

    record = read_json(first.project.record_file("run-0")) or {}
    inputs = (options.dense.model_dump(mode="json"), record.get("fingerprint"))
    return int(_once(project, "same-cameras", measure, *inputs)["points"])


def _once(project: Project, name: str, measure: Callable[[], _Row], *inputs: Any) -> _Row:
    """Return what `measure` returns, kept in a record while the matches, `inputs` and COLMAP are the same."""
    matches = read_json(project.record_file("matches")) or {}
    fingerprint = fingerprint_of(matches.get("fingerprint"), *inputs, library_versions("pycolmap"))
    record = read_json(project.record_file(name))
    if record is None or record.get("fingerprint") != fingerprint:
        began = time.monotonic()
        record = {**measure(), "fingerprint": fingerprint}
        record["seconds"] = time.monotonic() - began
        project.write_record(name, record)
    return {key: value for key, value in record.items() if key not in ("fingerprint", "seconds")}
