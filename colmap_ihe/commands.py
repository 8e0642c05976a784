"""What the commands do besides `reconstruct` and `status`: plain values in, plain values out."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from colmap_ihe import memory, oddities
from colmap_ihe.captures.discover import captures_of_files, discover
from colmap_ihe.colmap.cost import dense_cost
from colmap_ihe.colmap.dense import pick_backend
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.demo.folder import render_demo
from colmap_ihe.demo.truth import add_truth
from colmap_ihe.errors import ProjectError, WeightsError
from colmap_ihe.executor import local_executor, local_workers
from colmap_ihe.fitting import fit_captures
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.weights import Grey, grey_from_dict
from colmap_ihe.options import DevelopOptions, FitOptions, Options
from colmap_ihe.pages import write_page
from colmap_ihe.per_image import LeftOut
from colmap_ihe.pipeline import ROAD, Reconstruction, reconstruct, switched_off
from colmap_ihe.preprocess import survey
from colmap_ihe.progress import SILENT, Audience
from colmap_ihe.project import Project, read_json, write_bytes
from colmap_ihe.project_yaml import load_options
from colmap_ihe.recipes import prepared_set
from colmap_ihe.report.summary import summarise
from colmap_ihe.run import Record, Run
from colmap_ihe.version import __version__


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
    develop: DevelopOptions | None = None,
    calibration: Path | None = None,
    strict: bool = False,
    audience: Audience = SILENT,
) -> tuple[Grey, LeftOut]:
    """The weights of a set of folders and files, written to `output` if given; of the larger part where the
    set mixes RAW and gamma-coded photographs. Returns them and what was left out. Raises `KnownError`s."""
    if output is not None and output.suffix.lower() not in (".yaml", ".yml"):
        raise WeightsError(f"{output}: wanted a name that ends in .yaml", hint="as in -o weights.yaml")
    captures = captures_of_files(p for p in paths if not p.is_dir())
    discoveries = [discover(path) for path in paths if path.is_dir()]
    captures += [capture for found in discoveries for capture in found.captures]
    with local_executor() as executor, ExitStack() as stack:
        prepared = stack.enter_context(
            prepared_set(captures, develop, calibration, executor, audience, strict=strict)
        )
        surveyed, unreadable = prepared.surveyed, prepared.left_out
        ignored = tuple(name for found in discoveries for name in found.ignored)
        for text in oddities.warnings_of(surveyed, ignored):
            audience.warn(text)
        usable = [s.capture for s in surveyed]
        with audience.stage("fit") as watch:
            found = fit_captures(usable, options or FitOptions(), executor, watch, strict=strict)
    if len(found.weights) > 1:
        audience.warn(
            "the set mixes RAW and gamma-coded photographs: these are the weights of the larger part"
        )
    for text in oddities.fit_warnings(usable, found.weights.values()):
        audience.warn(text)
    if output is not None:
        write_bytes(
            output, yaml.safe_dump(found.main.as_dict(), sort_keys=False, default_flow_style=None).encode()
        )
    return found.main, unreadable | found.left_out


def read_weights(file: Path) -> Grey:
    """A weights file, as `fit -o` writes it. Raises `WeightsError`."""
    hint = "write one with `colmap-ihe fit IMAGES -o weights.yaml`"
    try:
        values = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error).splitlines()[0]
        raise WeightsError(f"{file}: cannot be read ({reason})", hint=hint) from error
    if isinstance(values, dict) and values.get("weights") is None and "parameters" in values:
        return _read_formula(file, values)
    triplet = values.get("weights") if isinstance(values, dict) else None
    if not isinstance(triplet, list) or len(triplet) != 3 or {type(w) for w in triplet} - {int, float}:
        came = triplet if isinstance(values, dict) else values
        raise WeightsError(
            f"{file}: not a weights file, it holds {came!r:.60}; wanted `weights: [r, g, b]`, three numbers",
            hint=hint,
        )
    try:
        return grey_from_dict(values, str(file))
    except WeightsError as error:
        if str(file) in str(error):
            raise
        raise WeightsError(f"{file}: {error}", hint=error.hint) from error


def _read_formula(file: Path, values: dict[str, Any]) -> Grey:
    """The conversion that is no triplet, tried on a few pixels."""
    grey = grey_from_dict(values, str(file))
    dark: NDArray[np.uint8] | NDArray[np.uint16] = np.zeros((8, 8, 3), np.uint8)
    if grey.encoding == "linear":
        dark = np.zeros((8, 8, 3), np.uint16)
    try:
        to_grey(dark, grey)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise WeightsError(
            f"{file}: {grey.method!r} with {values['parameters']!r:.60} is no conversion of a set",
            hint="write one with `colmap-ihe fit IMAGES --method NAME -o weights.yaml`",
        ) from error
    return grey


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
    if truth := (read_json(place.summary_file) or {}).get("truth"):  # of this very model, else it were gone
        summary["truth"] = truth
    with place.locked(), local_executor() as executor, audience.stage("page") as watch:
        run = Run(place, options, discover(place.images), executor, records)
        return write_page(run, summary, watch)


def doctor(
    project: Path | None = None, assignments: Sequence[str] = (), images: Path | None = None
) -> dict[str, Any]:
    """What is installed, and what will run where; with a project also what its dense stereo will take, if every
    photograph gets a place. Raises `KnownError`s of the project."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0
    packages = ("numpy", "opencv-python-headless", "rawpy", "pillow")
    return {
        "colmap-ihe": __version__,
        "python": platform.python_version(),
        "pycolmap": f"{pycolmap.__version__} ({pycolmap.COLMAP_version})",
        **{name: metadata.version(name) for name in packages},
        "cores": local_workers(),
        "memory_gb": round(total / 1e9, 1),
        "free_disk_gb": round(shutil.disk_usage(Path.cwd()).free / 1e9, 1),
        "cuda": bool(pycolmap.has_cuda),
        "dense_backend": pick_backend("auto"),
        **(_dense_cost(project, assignments, images) if project is not None else {}),
    }


def _dense_cost(project: Path, assignments: Sequence[str], images: Path | None) -> dict[str, Any]:
    place, options = Project.at(project, images), project_options(project, list(assignments)).dense
    captures = discover(place.images).captures
    with local_executor() as executor:
        surveyed, _ = survey(captures, executor, SILENT, strict=False)
    sizes = [(one.width, one.height) for one in surveyed]
    backend = pick_backend(options.backend)
    return dense_cost(sizes, options.max_image_size, backend, local_workers(), memory.available()).as_dict()
