"""The paper's evaluation on a project: the same photographs in several greys, side by side.

Each method has a project of its own below `compare/`, so that it resumes as any other: photographs are converted,
features found and matched once a method. The mapper runs with all matches, and once a seed without some of them, which
tells how much is chance. Dense stereo runs once a method, with the cameras of the first for all, so that it is the grey
that differs and nothing else.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from colmap_ihe.colmap.database import remove_database
from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.measures import rms_px, thin_out
from colmap_ihe.colmap.native import logged_to
from colmap_ihe.dense.cloud import dense_cloud
from colmap_ihe.errors import MappingError, OptionError
from colmap_ihe.evaluation.figures import errors_against, matching_of, plain_truth, truth_of
from colmap_ihe.evaluation.forecast import Ahead, dense_name, run_name
from colmap_ihe.evaluation.page import write_comparison
from colmap_ihe.evaluation.pair_list import read_pairs
from colmap_ihe.evaluation.parallel import match_together
from colmap_ihe.evaluation.significance import LEFT_OUT
from colmap_ihe.evaluation.tables import METHODS, PAPER, MethodResult, tables_of
from colmap_ihe.evaluation.truth import Truth
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.files import fingerprint_of, read_json, require_room, write_bytes, write_json
from colmap_ihe.machine.libraries import library_versions
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.machine.threads import limited
from colmap_ihe.photographs.discover import discover
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.project.folder import Project
from colmap_ihe.project.option_paths import native_assignments
from colmap_ihe.project.options import ClusterOptions, FitOptions, Options
from colmap_ihe.project.options_file import load_options

_Row = dict[str, Any]
_DEVELOPED = "developed"  # the folder of RAW photographs, developed once for all methods


def compare(
    project: str | Path,
    options: Options | None = None,
    *,
    methods: Sequence[str] = METHODS,
    seeds: int = 3,
    pairs: str | Path | None = None,
    images: str | Path | None = None,
    jobs: int = 1,
    progress: RunProgress = SILENT,
    executor: Executor | None = None,
) -> list[MethodResult]:
    """Measures each of `methods` on the photographs of a project; what was measured before is not measured again.

    `pairs` is a file of two photographs a line, in which matching is measured instead of in all pairs. As far as
    their matches, `jobs` methods run at a time, or all on `executor`, where it finds the same folders. Truth is read
    from PROJECT/truth, or from `gt` beside the photographs. Raises `KnownError`s; `OptionError` for a method that
    there is not, `Cancelled`.
    """
    options = options or Options()
    _check_names(methods)
    place = Project.at(Path(project), Path(images) if images else None)
    truth = truth_of(place)
    chosen = read_pairs(Path(pairs), [c.name for c in discover(place.images).captures]) if pairs else None
    found: list[MethodResult] = []
    own = Project.at(place.comparison, place.images)
    with ExitStack() as stack:
        stack.enter_context(own.locked())
        stack.enter_context(logged_to(own.native_log))
        stack.enter_context(limited(options.machine.threads))
        images_of = stack.enter_context(local_executor())
        projects: list[Reconstruction] = []
        wanted = list(dict.fromkeys(methods))
        homes = [_project_of(place, method, options) for method in wanted]
        said = native_assignments(options)
        if jobs > 1 or executor:
            with progress.stage("matching") as stage_progress:
                match_together(homes, said, place.comparison / _DEVELOPED, jobs, executor, stage_progress)
        for number, (method, one) in enumerate(zip(wanted, homes, strict=True)):
            ahead = Ahead(progress, one, options, wanted[number:], seeds)
            done = _matched(one, said, images_of, ahead)
            runs = {seed: _mapped(done, options, seed, truth, progress) for seed in range(seeds + 1)}
            projects.append(done)
            cameras = _seed_folder(projects[0], 0) / "0"
            if not found:
                _require_cameras(method, runs[0])
            found.append(
                MethodResult(
                    method,
                    done.summary["weights"] and tuple(done.summary["weights"]),
                    matching_of(done.project, cameras, chosen),
                    runs,
                    _dense_points(done, projects[0], options, images_of, progress),
                )
            )
        shutil.rmtree(place.comparison / _DEVELOPED, ignore_errors=True)
        _write(place, found)
        write_comparison(place, found, [done.project for done in projects], cameras)
    return found


def _check_names(methods: Sequence[str]) -> None:
    for method in methods:
        if method not in (*CONVERSIONS, PAPER) or method == "auto":
            raise OptionError(
                f"no method is called {method!r}",
                hint=f"the methods are {', '.join(m for m in CONVERSIONS if m != 'auto')}, {PAPER}",
            )


def _require_cameras(method: str, run: Mapping[str, float]) -> None:
    if not run["registered"]:
        raise MappingError(
            f"{method}: no photograph has a place in its model, and its cameras would serve for all methods",
            hint="name another method first",
        )


def _write(place: Project, found: Sequence[MethodResult]) -> None:
    write_json(place.comparison / "compare.json", [asdict(one) for one in found])
    for table in tables_of(found):
        write_bytes(place.comparison / f"{table.name}.csv", table.as_csv().encode())
        write_bytes(place.comparison / f"{table.name}.tex", table.as_latex().encode())


def _project_of(place: Project, method: str, options: Options) -> Project:
    """A project of its own for the method, with all that the user's holds besides photographs, and its options."""
    root = place.comparison / method
    root.mkdir(parents=True, exist_ok=True)
    for given in ("masks", "calibration"):
        if (place.root / given).is_dir() and not (root / given).exists():
            (root / given).symlink_to((place.root / given).resolve(), target_is_directory=True)
    one = Project.at(root, place.images)
    own = options.model_copy(  # it may itself run on a worker, which must not wait for workers
        update={"fit": _fit_of(method, options.fit), "cluster": ClusterOptions()}
    )
    write_bytes(one.options_file, yaml.safe_dump(own.as_yaml(), sort_keys=False).encode())
    _share(Project.at(place.comparison, place.images), one)
    return one


def _matched(one: Project, said: Sequence[str], executor: Executor, progress: RunProgress) -> Reconstruction:
    """As far as verified matches. `said`: what goes over its project.yaml."""
    return reconstruct(
        one.root,
        load_options(one.options_file, said),
        images=one.images,
        until="matches",
        progress=progress,
        executor=executor,
        developed=one.root.parent / _DEVELOPED,
    )


def _share(own: Project, one: Project) -> None:
    """What does not depend on the grey is found once for all methods: means of calibration frames, and what the
    photographs hold."""
    own.masters.mkdir(parents=True, exist_ok=True)
    one.records.mkdir(parents=True, exist_ok=True)
    if not one.masters.exists():
        one.masters.symlink_to(own.masters, target_is_directory=True)
    for known in sorted(own.root.glob(f"*/{one.digests_file.relative_to(one.root)}")):
        if not one.digests_file.exists():
            write_bytes(one.digests_file, known.read_bytes())


def _fit_of(method: str, options: FitOptions) -> FitOptions:
    guard = {"ihe": "noise", PAPER: "none"}.get(method, options.guard)
    name = "ihe" if method == PAPER else method
    return options.model_copy(update={"method": name, "guard": guard, "measure": False, "weights": None})


def _seed_folder(done: Reconstruction, seed: int) -> Path:
    return done.project.workspace / "seeds" / str(seed)


def _mapped(
    done: Reconstruction, options: Options, seed: int, truth: Truth | None, progress: RunProgress
) -> Mapping[str, float]:
    """What one run of the mapper came to: with all matches for seed 0, else without some."""
    project, folder = done.project, _seed_folder(done, seed)
    images = int(done.summary["images"]) - len(done.summary["left_out"])

    def measure() -> _Row:
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        database = project.database
        if seed:
            database = folder.with_name(f"{seed}.db")
            thin_out(project.database, database, LEFT_OUT, seed)
        try:
            with progress.stage(run_name(project.root.name, seed)) as stage_progress:
                model = map_images(database, project.grey, folder, options.sparse, images, stage_progress)[0]
        except MappingError as error:
            progress.warn(f"{project.root.name}, run {seed}: {error}")
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
        return row | (errors_against(truth, folder / "0") if truth else {})

    inputs = (
        options.sparse.model_dump(mode="json"),
        LEFT_OUT,
        plain_truth(truth),
        library_versions("pycolmap"),
    )
    return _once(project, f"run-{seed}", measure, *inputs)


def _dense_points(
    done: Reconstruction,
    first: Reconstruction,
    options: Options,
    executor: Executor,
    progress: RunProgress,
) -> int | None:
    if not options.dense.enabled:
        return None
    project = done.project
    cameras, dense = _seed_folder(first, 0) / "0", project.workspace / "same-cameras"

    def measure() -> _Row:
        shutil.rmtree(dense, ignore_errors=True)
        with progress.stage(dense_name(project.root.name)) as stage_progress:
            made = dense_cloud(
                cameras,
                project.grey,
                project.colour,
                project.made_masks,
                dense,
                options.dense,
                executor,
                stage_progress,
                partial(require_room, project.root),
            )
        cloud = project.workspace / "same-cameras.ply"
        (dense / "fused.ply").replace(cloud)
        shutil.rmtree(dense)
        return {"points": made["points"]}

    record = read_record(first.project, "run-0") or {}
    inputs = (options.dense.model_dump(mode="json"), record.get("fingerprint"), library_versions("pycolmap"))
    return int(_once(project, "same-cameras", measure, *inputs)["points"])


def _once(project: Project, name: str, measure: Any, *inputs: Any) -> _Row:
    """What `measure` returns, kept in a record for as long as the matches and `inputs` are the same."""
    matches = read_json(project.record_file("matches")) or {}
    fingerprint = fingerprint_of(matches.get("fingerprint"), *inputs)
    record = read_record(project, name)
    if record is None or record.get("fingerprint") != fingerprint:
        began = time.monotonic()
        record = {**measure(), "fingerprint": fingerprint}
        record["seconds"] = time.monotonic() - began
        project.write_record(name, record)
    return {key: value for key, value in record.items() if key not in ("fingerprint", "seconds")}
