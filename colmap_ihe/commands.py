"""What the commands do besides `reconstruct` and `status`: plain values in, plain values out."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path
from typing import Any

from colmap_ihe import campaigns, foreseen, memory, misfit, oddities
from colmap_ihe.campaigns import campaigns_of
from colmap_ihe.captures.discover import Capture, discover
from colmap_ihe.colmap.cost import dense_cost
from colmap_ihe.colmap.dense import pick_backend
from colmap_ihe.colmap.native import cuda_devices, pycolmap
from colmap_ihe.demands import Set, demands_of
from colmap_ihe.demo.folder import render_demo
from colmap_ihe.demo.truth import add_truth
from colmap_ihe.errors import ProjectError, WeightsError
from colmap_ihe.executor import local_executor, local_workers
from colmap_ihe.files import read_json
from colmap_ihe.fitting import Fit, fit_captures
from colmap_ihe.grey.weights import Grey, Weights
from colmap_ihe.options import DevelopOptions, FitOptions, Options
from colmap_ihe.pages import write_page
from colmap_ihe.per_image import LeftOut, refused
from colmap_ihe.pipeline import Reconstruction, reconstruct
from colmap_ihe.preprocess import Surveyed, survey
from colmap_ihe.progress import SILENT, Audience
from colmap_ihe.project import Project
from colmap_ihe.project_yaml import load_options
from colmap_ihe.recipes import prepared_set
from colmap_ihe.report.summary import summarise
from colmap_ihe.road import ROAD, switched_off
from colmap_ihe.run import Record, Run
from colmap_ihe.stored import SUFFIX, Stored, write_stored
from colmap_ihe.version import __version__
from colmap_ihe.weights_file import write_weights


def project_options(project: Path, assignments: list[str]) -> Options:
    return load_options(project / "project.yaml", assignments)


def demo(folder: Path, assignments: list[str], audience: Audience) -> Reconstruction:
    """Renders the demo into `folder`, reconstructs it, and adds its error against the truth."""
    if (folder / "images").exists() and not (folder / "truth").exists():
        raise ProjectError(
            f"{folder}: holds photographs that are not the demo's", hint="name another folder for the demo"
        )
    options = project_options(folder, assignments)
    with audience.stage("render") as watch:
        render_demo(folder, watch=watch)
    done = add_truth(reconstruct(folder, options, audience=audience), folder / "truth")
    if done.project.page_file.exists():
        report(folder, assignments, audience=audience)  # now with the truth
    return done


def fit_files(
    paths: Sequence[Path],
    options: FitOptions | None = None,
    *,
    output: Path | None = None,
    histogram: Path | None = None,
    weights: Grey | None = None,
    develop: DevelopOptions | None = None,
    calibration: Path | None = None,
    strict: bool = False,
    audience: Audience = SILENT,
) -> tuple[Grey, LeftOut]:
    """The weights of a set of projects, histograms, folders and files, written to `output` if given; of the larger
    part where the set mixes RAW and gamma-coded photographs. What was counted is written to `histogram`, which is
    one to name in a later fit. With `weights` nothing is fitted: the owner is told whether they fit the set. Returns
    them and what was left out. Raises `KnownError`s."""
    _require_suffix(output, (".yaml", ".yml"), "-o weights.yaml")
    _require_suffix(histogram, (SUFFIX,), f"--histogram all{SUFFIX}")
    options, develop = options or FitOptions(), develop or DevelopOptions()
    found = campaigns_of(paths, develop, calibration)
    for text in found.notes:
        audience.warn(text)
    surveyed: list[Surveyed] = []
    unreadable: LeftOut = {}
    for source in found.sources:
        unreadable |= refused(source, strict)
    with local_executor() as executor, ExitStack() as stack:
        for source in found.sources:
            how = (source.captures, source.develop, source.calibration, executor, audience)
            prepared = stack.enter_context(prepared_set(*how, strict=strict))
            surveyed += prepared.surveyed
            unreadable |= prepared.left_out
        ignored = tuple(name for source in found.sources for name in source.ignored)
        for text in oddities.warnings_of(surveyed, ignored) if surveyed else ():
            audience.warn(text)
        usable = [s.capture for s in surveyed]
        with audience.stage("fit") as watch:
            fit = fit_captures(
                usable, options, executor, watch, strict=strict, stored=found.stored, given=weights
            )
    developments: list[tuple[str, Mapping[str, Any]]] = [(s.source, s.development) for s in found.stored]
    developments += [
        (str(s.captures[0].path.parent), s.develop.model_dump(mode="json")) for s in found.sources
    ]
    for text in _warnings_of(fit, usable, weights, options, developments):
        audience.warn(text)
    if histogram is not None:
        write_stored(histogram, Stored(fit.gathered, options.sample, developments[0][1]))
    if output is not None:
        write_weights(output, fit.main)
    return fit.main, unreadable | fit.left_out


def _require_suffix(file: Path | None, suffixes: Sequence[str], example: str) -> None:
    if file is not None and file.suffix.lower() not in suffixes:
        raise WeightsError(f"{file}: wanted a name that ends in {suffixes[0]}", hint=f"as in {example}")


def _warnings_of(
    fit: Fit,
    usable: Sequence[Capture],
    given: Grey | None,
    options: FitOptions,
    developments: Sequence[tuple[str, Mapping[str, Any]]],
) -> list[str]:
    words = campaigns.warnings_of(fit.gathered.values(), developments)
    if len(fit.weights) > 1:
        words.append(
            "the set mixes RAW and gamma-coded photographs: these are the weights of the larger part"
        )
    if isinstance(given, Weights):
        return words + misfit.warnings_of(given, fit.gathered[given.encoding], options)
    return words + (oddities.fit_warnings(usable, fit.weights.values()) if usable else [])


def report(
    project: Path, assignments: Sequence[str] = (), images: Path | None = None, audience: Audience = SILENT
) -> Path:
    """Writes report/index.html of a project again, from what its stages left, and returns it. Raises
    `KnownError`s; `ProjectError` where nothing is converted yet."""
    options, place = project_options(project, list(assignments)), Project.at(project, images)
    records: dict[str, Record] = {}
    for stage in ROAD:
        record = None if switched_off(stage.name, options) else place.read_record(stage.name)
        if record is None:
            break
        records[stage.name] = record
    if "convert" not in records:
        raise ProjectError(
            f"{project}: no photograph is converted yet, so there is nothing to show",
            hint="run `colmap-ihe reconstruct` first",
        )
    summary = summarise(records, options)
    truth = (read_json(place.summary_file) or {}).get("truth")  # of this very model, else it were gone
    if isinstance(truth, dict) and all(type(value) in (int, float) for value in truth.values()):
        summary["truth"] = truth
    with place.locked(), local_executor() as executor, audience.stage("page") as watch:
        run = Run(place, options, discover(place.images), executor, records)
        return write_page(run, summary, watch)


def doctor(
    project: Path | None = None, assignments: Sequence[str] = (), images: Path | None = None
) -> dict[str, Any]:
    """What is installed, and what will run where; with a project also what its stages will take of memory and disk, and
    its dense stereo if every photograph gets a place. Raises `KnownError`s of the project."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0
    packages = ("numpy", "opencv-python-headless", "rawpy", "pillow")
    return {
        "colmap-ihe": __version__,
        "python": platform.python_version(),
        "pycolmap": f"{pycolmap.__version__} ({pycolmap.COLMAP_version})",
        **{name: metadata.version(name) for name in packages},
        "cores": local_workers(),
        "memory_gb": round(total / 1e9, 1),
        "free_disk_gb": round(shutil.disk_usage(_nearest(project or Path.cwd())).free / 1e9, 1),
        "cuda": bool(pycolmap.has_cuda),
        "cuda_devices": cuda_devices(),
        "dense_backend": pick_backend("auto"),
        **(_demands(project, assignments, images) if project is not None else {}),
    }


def _nearest(folder: Path) -> Path:
    """The folder, or of those above it the first that is there."""
    place = folder.absolute()
    return next(one for one in (place, *place.parents) if one.is_dir())


def _demands(project: Path, assignments: Sequence[str], images: Path | None) -> dict[str, Any]:
    place, options = Project.at(project, images), project_options(project, list(assignments))
    captures = discover(place.images).captures
    with local_executor() as executor:
        surveyed, _ = survey(captures, executor, SILENT, strict=False)
    sizes = [(one.width, one.height) for one in surveyed]
    found = {one.stage: one for one in demands_of(options, Set.of_survey(surveyed))}
    backend, size = pick_backend(options.dense.backend), options.dense.max_image_size
    dense = dense_cost(sizes, size, backend, local_workers(), memory.available())
    return {
        **{f"{name}_will_take": foreseen.in_words(one) for name, one in found.items()},
        "memory_needed_gb": round(max(one.memory_bytes(1) for one in found.values()) / 1e9, 2),
        "disk_needed_gb": round(
            sum(foreseen.disk_left(place, list(found.values()), found).values()) / 1e9, 2
        ),
        **(dense.as_dict() if options.dense.enabled else {}),
    }
