"""What the commands do besides `reconstruct` and `status`: plain values in, plain values out."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml

from colmap_ihe.captures.discover import Capture, captures_of_files, discover
from colmap_ihe.captures.encode import SUFFIXES
from colmap_ihe.colmap.dense import pick_backend
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.demo.folder import render_demo
from colmap_ihe.demo.truth import add_truth
from colmap_ihe.errors import ProjectError, WeightsError
from colmap_ihe.executor import local_executor, local_workers
from colmap_ihe.grey.weights import Weights
from colmap_ihe.options import ConvertOptions, FitOptions, Options, load_options
from colmap_ihe.pipeline import Reconstruction, reconstruct
from colmap_ihe.preprocess import Fit, LeftOut, convert_captures, fit_captures, survey
from colmap_ihe.progress import SILENT, Audience
from colmap_ihe.project import digest_file, fingerprint_of, read_json, write_bytes, write_json
from colmap_ihe.version import __version__

_CONVERT_RECORD = ".colmap-ihe.json"


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
    return add_truth(reconstruct(folder, options, audience=audience), folder / "truth")


def fit_files(
    paths: Sequence[Path],
    options: FitOptions | None = None,
    *,
    output: Path | None = None,
    strict: bool = False,
    audience: Audience = SILENT,
) -> tuple[Weights, LeftOut]:
    """The weights of a set of folders and files, written to `output` if given; of the larger part where the
    set mixes RAW and gamma-coded photographs. Raises `KnownError`s."""
    if output is not None and output.suffix.lower() not in (".yaml", ".yml"):
        raise WeightsError(f"{output}: wanted a name that ends in .yaml", hint="as in -o weights.yaml")
    captures = captures_of_files(p for p in paths if not p.is_dir())
    captures += [capture for path in paths if path.is_dir() for capture in discover(path).captures]
    found = _fit(captures, options or FitOptions(), audience, strict=strict)
    if len(found.weights) > 1:
        audience.warn(
            "the set mixes RAW and gamma-coded photographs: these are the weights of the larger part"
        )
    if output is not None:
        write_bytes(output, yaml.safe_dump(found.main.as_dict(), sort_keys=False).encode())
    return found.main, found.left_out


def convert_folder(
    images: Path,
    out: Path,
    *,
    fit: FitOptions | None = None,
    weights: Weights | None = None,
    options: ConvertOptions | None = None,
    strict: bool = False,
    audience: Audience = SILENT,
) -> tuple[Weights, dict[str, str], LeftOut]:
    """Grey images of the folder `images`, with their EXIF, in the folder `out`.

    `weights` are used if given, else fitted by `fit`. Returns the weights (of the larger part of a mixed
    set), the names of the grey images by photograph, and what was left out. What an unfinished or earlier
    run on the same input left in `out` is kept. Raises `KnownError`s; `ProjectError` if `out` holds
    anything that we did not write.
    """
    images, out = images.absolute(), out.absolute()
    if out == images or out.is_relative_to(images) or images.is_relative_to(out):
        raise ProjectError(
            f"{out}: lies in the folder of photographs or holds it", hint="use a folder of its own"
        )
    captures, left_out = list(discover(images).captures), LeftOut()
    options = options or ConvertOptions()
    if weights is not None:
        found = Fit({weights.encoding: weights})
    else:
        found = _fit(captures, fit or FitOptions(), audience, strict=strict)
        left_out |= found.left_out
    usable = [c for c in captures if c.name not in left_out]
    content = [[c.name, c.grey_stem, digest_file(c.path)] for c in usable]
    by_encoding = {e: w.as_dict() for e, w in found.weights.items()}
    names = [c.grey_stem + SUFFIXES[options.format] for c in usable]
    keep = _claim(out, fingerprint_of(__version__, by_encoding, options.model_dump(), content), names)
    with local_executor() as executor, audience.stage("convert") as watch:
        surveyed, unreadable = survey(usable, executor, watch, strict=strict)
        grey, failed = convert_captures(
            surveyed, found, options, out, None, executor, watch, strict=strict, keep_finished=keep
        )
    left_out |= unreadable | failed
    for reason in left_out.values():
        audience.warn(f"left out: {reason}")
    return found.main, grey, left_out


def _claim(out: Path, fingerprint: str, names: list[str]) -> bool:
    """Makes `out` ours for the files `names`; True if what lies there came from the same input. Of an earlier
    input only what we wrote is removed. Raises `ProjectError` if a file is there that we did not write."""
    if out.exists() and not out.is_dir():
        raise ProjectError(f"{out}: is a file, wanted a folder", hint="name an empty or a new folder")
    record = read_json(out / _CONVERT_RECORD)
    if record is None and out.exists() and any(out.iterdir()):
        raise ProjectError(
            f"{out}: is not empty, and not of an earlier convert", hint="name an empty or a new folder"
        )
    if record is not None and record.get("fingerprint") == fingerprint:
        return True
    ours = set(record.get("files", [])) if record is not None else set()
    strangers = [name for name in names if name not in ours and (out / name).exists()]
    if strangers:
        raise ProjectError(
            f"{out / strangers[0]}: is there already and was not written by convert", hint="move it away"
        )
    for name in ours:
        if not Path(name).is_absolute() and ".." not in Path(name).parts:
            (out / name).unlink(missing_ok=True)
    write_json(out / _CONVERT_RECORD, {"fingerprint": fingerprint, "files": names})
    return False


def read_weights(file: Path) -> Weights:
    """A weights file, as `fit -o` writes it. Raises `WeightsError`."""
    try:
        values = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise WeightsError(
            f"{file}: cannot be read ({str(error).splitlines()[0]})",
            hint="write one with `colmap-ihe fit IMAGES -o weights.yaml`",
        ) from error
    return Weights.from_dict(values, str(file))


def doctor() -> dict[str, Any]:
    """What is installed, and what will run where."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0
    packages = ("numpy", "opencv-python-headless", "rawpy", "pillow")
    return {
        "colmap-ihe": __version__,
        "python": platform.python_version(),
        "pycolmap": f"{pycolmap.__version__} ({pycolmap.COLMAP_version})",
        **{name: metadata.version(name) for name in packages},
        "cores": local_workers(),
        "memory_gb": round(memory / 1e9, 1),
        "free_disk_gb": round(shutil.disk_usage(Path.cwd()).free / 1e9, 1),
        "cuda": bool(pycolmap.has_cuda),
        "dense_backend": pick_backend("auto"),
    }


def _fit(captures: list[Capture], options: FitOptions, audience: Audience, *, strict: bool) -> Fit:
    with local_executor() as executor, audience.stage("fit") as watch:
        return fit_captures(captures, options, executor, watch, strict=strict)
