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

import numpy as np

from colmap_ihe.colmap.cloud import dense_cloud
from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.measures import poses_of, putative_and_inliers, rms_px, thin_out
from colmap_ihe.colmap.native import logged_to
from colmap_ihe.colmap.workspace import remove_database
from colmap_ihe.compare_page import write_comparison
from colmap_ihe.compared import METHODS, PAPER, Compared, tables_of
from colmap_ihe.errors import MappingError, OptionError
from colmap_ihe.evaluate.paired import LEFT_OUT
from colmap_ihe.evaluate.pairs import (
    MOVEMENTS,
    PairMatches,
    area_under_curve_percent,
    efficiency_percent,
    movement,
    relative_errors_deg,
)
from colmap_ihe.evaluate.truth import Truth, key_of, pose_errors, read_truth
from colmap_ihe.executor import local_executor
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.options import FitOptions, Options
from colmap_ihe.pipeline import Reconstruction, reconstruct
from colmap_ihe.progress import SILENT, Audience
from colmap_ihe.project import Project, fingerprint_of, read_json, require_room, write_bytes, write_json
from colmap_ihe.version import library_versions

AUC_DEG = 5.0

_Row = dict[str, Any]


def compare(
    project: str | Path,
    options: Options | None = None,
    *,
    methods: Sequence[str] = METHODS,
    seeds: int = 3,
    images: str | Path | None = None,
    audience: Audience = SILENT,
) -> list[Compared]:
    """Measures each of `methods` on the photographs of a project; what was measured before is not measured again.

    Truth is read from PROJECT/truth, or from `gt` beside the photographs. Raises `KnownError`s; `OptionError` for a
    method that there is not, `Cancelled`.
    """
    options = options or Options()
    for method in methods:
        if method not in (*CONVERSIONS, PAPER) or method == "auto":
            raise OptionError(
                f"no method is called {method!r}",
                hint=f"the methods are {', '.join(m for m in CONVERSIONS if m != 'auto')}, {PAPER}",
            )
    place = Project.at(Path(project), Path(images) if images else None)
    truth = _truth(place)
    found: list[Compared] = []
    own = Project.at(place.comparison, place.images)
    with ExitStack() as stack:
        stack.enter_context(own.locked())
        stack.enter_context(logged_to(own.native_log))
        executor = stack.enter_context(local_executor())
        projects: list[Reconstruction] = []
        for method in dict.fromkeys(methods):
            done = _matched(place, method, options, executor, audience)
            runs = {seed: _mapped(done, options, seed, truth, audience) for seed in range(seeds + 1)}
            projects.append(done)
            first = projects[0]
            if not found and not runs[0]["registered"]:
                raise MappingError(
                    f"{method}: no photograph has a place in its model, and its cameras would serve for all methods",
                    hint="name another method first",
                )
            found.append(
                Compared(
                    method,
                    done.summary["weights"] and tuple(done.summary["weights"]),
                    _matching(done, _seed_folder(first, 0)),
                    runs,
                    _dense_points(done, first, options, executor, audience),
                )
            )
        write_json(place.comparison / "compare.json", [asdict(one) for one in found])
        for table in tables_of(found):
            write_bytes(place.comparison / f"{table.name}.csv", table.as_csv().encode())
            write_bytes(place.comparison / f"{table.name}.tex", table.as_latex().encode())
        write_comparison(place, found, [done.project for done in projects], _seed_folder(first, 0) / "0")
    return found


def _truth(place: Project) -> Truth | None:
    for folder in (place.root / "truth", place.images / "gt"):
        if folder.is_dir():
            return read_truth(folder)
    return None


def _content_of(truth: Truth | None) -> list[Any] | None:
    """What figures against a truth depend on, as plain values."""
    if truth is None:
        return None
    return [
        truth.extent_m,
        *((key, image.cam_from_world.tolist()) for key, image in sorted(truth.images.items())),
    ]


def _matched(
    place: Project, method: str, options: Options, executor: Executor, audience: Audience
) -> Reconstruction:
    """A project of its own for the method, as far as verified matches."""
    root = place.comparison / method
    root.mkdir(parents=True, exist_ok=True)
    for shared in ("masks", "calibration"):
        if (place.root / shared).is_dir() and not (root / shared).exists():
            (root / shared).symlink_to((place.root / shared).resolve(), target_is_directory=True)
    return reconstruct(
        root,
        options.model_copy(update={"fit": _fit_of(method, options.fit)}),
        images=place.images,
        until="matches",
        audience=audience,
        executor=executor,
    )


def _fit_of(method: str, options: FitOptions) -> FitOptions:
    guard = {"ihe": "noise", PAPER: "none"}.get(method, options.guard)
    name = "ihe" if method == PAPER else method
    return options.model_copy(update={"method": name, "guard": guard, "measure": False, "weights": None})


def _seed_folder(done: Reconstruction, seed: int) -> Path:
    return done.project.workspace / "seeds" / str(seed)


def _mapped(
    done: Reconstruction, options: Options, seed: int, truth: Truth | None, audience: Audience
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
            with audience.stage(f"{project.root.name}, run {seed}") as watch:
                model = map_images(database, project.grey, folder, options.sparse, images, watch)[0]
        except MappingError as error:
            audience.warn(f"{project.root.name}, run {seed}: {error}")
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
        return row | (_against(folder / "0", truth) if truth else {})

    inputs = (
        options.sparse.model_dump(mode="json"),
        LEFT_OUT,
        _content_of(truth),
        library_versions("pycolmap"),
    )
    return _once(project, f"run-{seed}", measure, *inputs)


def _against(model: Path, truth: Truth) -> _Row:
    poses = {key_of(name): pose for name, pose in poses_of(model).items()}
    errors = pose_errors(poses, truth)
    true = {key: image.cam_from_world for key, image in truth.images.items()}
    relative = relative_errors_deg(poses, true)
    return {
        "rotation_deg": errors.rotation_error_deg,
        "position_m": float(np.mean(list(errors.position_m.values()))),
        "auc_percent": area_under_curve_percent(relative, AUC_DEG),
    }


def _matching(done: Reconstruction, cameras: Path) -> dict[str, dict[str, float | None]]:
    """By movement of the camera, as the cameras of the first method tell it, and over all pairs."""
    poses = poses_of(cameras / "0")
    kinds: dict[str, list[PairMatches]] = {"all": [], **{name: [] for name in MOVEMENTS}}
    for (one, other), counts in putative_and_inliers(done.project.database).items():
        pair = PairMatches(*counts)
        kinds["all"].append(pair)
        if one in poses and other in poses and pair.inliers:
            kinds[movement(poses[one], poses[other])].append(pair)
    return {
        name: {
            "pairs": len(pairs),
            "putative": sum(p.putative for p in pairs),
            "inliers": sum(p.inliers for p in pairs),
            "efficiency_percent": efficiency_percent(pairs),
        }
        for name, pairs in kinds.items()
    }


def _dense_points(
    done: Reconstruction, first: Reconstruction, options: Options, executor: Executor, audience: Audience
) -> int | None:
    if not options.dense.enabled:
        return None
    project = done.project
    cameras, dense = _seed_folder(first, 0) / "0", project.workspace / "same-cameras"

    def measure() -> _Row:
        shutil.rmtree(dense, ignore_errors=True)
        with audience.stage(f"{project.root.name}, dense") as watch:
            made = dense_cloud(
                cameras,
                project.grey,
                project.colour,
                project.made_masks,
                dense,
                options.dense,
                executor,
                watch,
                partial(require_room, project.root),
            )
        cloud = project.workspace / "same-cameras.ply"
        (dense / "fused.ply").replace(cloud)
        shutil.rmtree(dense)
        return {"points": made["points"]}

    record = first.project.read_record("run-0") or {}
    inputs = (options.dense.model_dump(mode="json"), record.get("fingerprint"), library_versions("pycolmap"))
    return int(_once(project, "same-cameras", measure, *inputs)["points"])


def _once(project: Project, name: str, measure: Any, *inputs: Any) -> _Row:
    """What `measure` returns, kept in a record for as long as the matches and `inputs` are the same."""
    matches = read_json(project.record_file("matches")) or {}
    fingerprint = fingerprint_of(matches.get("fingerprint"), *inputs)
    record = project.read_record(name)
    if record is None or record.get("fingerprint") != fingerprint:
        began = time.monotonic()
        record = {**measure(), "fingerprint": fingerprint}
        record["seconds"] = time.monotonic() - began
        project.write_record(name, record)
    return {key: value for key, value in record.items() if key not in ("fingerprint", "seconds")}
