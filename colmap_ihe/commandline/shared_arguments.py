"""Add the arguments that several commands share, and turn them into assignments of options."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import shtab

from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.project.options import DevelopOptions
from colmap_ihe.project.options_file import load_options
from colmap_ihe.project.recipe import Demosaic

Command = Callable[[str, str], argparse.ArgumentParser]
Parser = argparse._ActionsContainer

_PATHS = {"PROJECT", "ROOT", "IMAGES", "OUT", "DIR", "FILE"}


def add(parser: Parser, names: str, text: str | None = None, **more: Any) -> None:
    """Add an argument, as `-o --output FILE`: its names, and what its value is called, if it has one. Its help ends
    with its default, in brackets; `text` may say it in words."""
    *words, value = names.split()
    if value.isupper():
        kind = {"type": Path} if value in _PATHS else {}
        action = parser.add_argument(*words, **{"metavar": value, "help": text, **kind, **more})
    else:
        action = parser.add_argument(*words, value, help=text, **more)
    if value in _PATHS:  # what a shell completes
        action.complete = shtab.FILE if value in ("FILE", "IMAGES") else shtab.DIRECTORY  # type: ignore[attr-defined]
    if isinstance(action, argparse.BooleanOptionalAction):
        action.help = f"{text} ({'on' if action.default else 'off'})"
    elif action.option_strings and action.nargs != 0 and not str(text).endswith(")"):
        action.help = f"{text} ({'none' if action.default in (None, []) else '%(default)s'})"


def add_switch(parser: Parser, names: str, text: str) -> None:
    """Add an argument that takes no value."""
    add(parser, names, text, action="store_true")


def add_project(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """Add PROJECT, --images and --set."""
    add(parser, "project PROJECT", "the project's folder", nargs=nargs)
    add(parser, "--images DIR", "photographs, if not in PROJECT/images")
    add_set(parser)


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add --set."""
    text = "change an option, as in --set dense.max_image_size=2400; see docs/options.md"
    add(parser, "--set STAGE.OPTION=VALUE", text, action="append", default=[], dest="assignments")


def add_camera(parser: argparse.ArgumentParser) -> None:
    """Add --focal-length and --sensor-width."""
    group = parser.add_argument_group(
        "photographs without EXIF",
        "For scans, and for photographs by drones, old lenses and programs that leave their focal length out: COLMAP"
        " then need not guess it. EXIF is left as it is. For several cameras write `cameras:` into project.yaml; see"
        " docs/options.md.",
    )
    add(group, "--focal-length MM", "as on the lens, not the 35 mm equivalent", type=float)
    add(group, "--sensor-width MM", "along the longer side, as 36 for full frame", type=float)


def camera_assignments(parsed: argparse.Namespace) -> list[str]:
    """Return the camera's arguments as assignments of options."""
    given = {"focal_length": parsed.focal_length, "sensor_width": parsed.sensor_width}
    return [f"cameras.*.{name}={value}" for name, value in given.items() if value is not None]


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add what bounds a run: --cluster, --threads, --no-dense, --no-mesh and --strict."""
    text = (
        "work on the workers of this Dask scheduler, as tcp://login1:8786, or on N worker processes here,"
        " local:N; see docs/cluster.md"
    )
    add(parser, "--cluster ADDRESS", text)
    text = (
        "use at most N cores (all); with 1 the same photographs and options give the same model, bit for bit"
    )
    add(parser, "--threads N", text, type=count)
    add_switch(parser, "--no-dense", "end with the sparse model")
    add_switch(parser, "--no-mesh", "end with the dense cloud")
    add_strict(parser)
    add_camera(parser)


def add_strict(parser: argparse.ArgumentParser) -> None:
    """Add --strict."""
    add_switch(parser, "--strict", "stop at a photograph that cannot be used")


def run_assignments(parsed: argparse.Namespace) -> list[str]:
    """Return the arguments of a run as assignments of options."""
    given = {
        "dense.enabled=false": parsed.no_dense,
        "mesh.enabled=false": parsed.no_mesh,
        "captures.strict=true": parsed.strict,
        f"machine.threads={parsed.threads}": parsed.threads,
        f"cluster.address={json.dumps(parsed.cluster)}": parsed.cluster,
    }
    chosen = [assignment for assignment, is_given in given.items() if is_given]
    return [*parsed.assignments, *camera_assignments(parsed), *chosen]


def count(text: str) -> int:
    """Return a number from 1 on."""
    if not text.isascii() or not text.isdigit() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r}, expected a number from 1 on")
    return int(text)


def duration(text: str) -> float:
    """Return a length of time in seconds."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text.strip(), re.ASCII)
    if match is None or not float(match[1]):
        raise argparse.ArgumentTypeError(f"{text!r}, expected a length of time such as 45s, 90m or 2h")
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600}[match[2]]


def add_weights(parser: argparse.ArgumentParser, weights_help: str) -> None:
    """Add --method and --weights, of which one may be given."""
    group = parser.add_mutually_exclusive_group()
    text = "the conversion to grey, see docs/conversions.md"
    add(group, "--method", text, choices=tuple(CONVERSIONS), default="ihe")
    add(group, "--weights FILE", weights_help)


def add_development(parser: argparse.ArgumentParser) -> None:
    """Add the options of development of RAW, and --strict."""
    group = parser.add_argument_group("development of RAW, as `develop` in docs/options.md")
    add(group, "--calibration DIR", "holds bias/, darks/, flats/ or bad-pixels.txt")
    text = "how colours between the pixels of a mosaic are found"
    add(group, "--demosaic", text, choices=get_args(Demosaic), default="linear")
    text = "bring both greens of a Bayer mosaic level"
    add(group, "--green-equilibrium", text, action=argparse.BooleanOptionalAction, default=True)
    add_switch(group, "--find-bad-pixels", "look for them over the set, without dark frames")
    choices = ("as_shot", "normalise")
    text = "normalise: to one exposure, by EXIF"
    add(group, "--exposure", text, choices=choices, default="as_shot")
    add_switch(group, "--balance", "colour balance across the set, of any photographs")
    add(group, "--denoise N", "in deviations of the noise, of any photographs", type=float, default=0.0)
    add_strict(parser)


def development(parsed: argparse.Namespace) -> DevelopOptions:
    """Return the arguments of `add_development` as options."""
    names = DevelopOptions.model_fields
    return load_options(None, [f"develop.{n}={json.dumps(getattr(parsed, n))}" for n in names]).develop
