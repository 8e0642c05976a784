"""Add the arguments that several commands share, and turn them into assignments of options."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.project.options import DevelopOptions
from colmap_ihe.project.options_file import load_options
from colmap_ihe.project.recipe import Demosaic

Command = Callable[[str, str], argparse.ArgumentParser]


def add_project(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """Add PROJECT, --images and --set."""
    parser.add_argument("project", type=Path, nargs=nargs, metavar="PROJECT", help="the project's folder")
    parser.add_argument("--images", type=Path, metavar="DIR", help="photographs, if not in PROJECT/images")
    add_set(parser)


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add --set."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="STAGE.OPTION=VALUE",
        dest="assignments",
        help="change an option, as in --set dense.max_image_size=2400; see docs/options.md",
    )


def add_camera(parser: argparse.ArgumentParser) -> None:
    """Add --focal-length and --sensor-width."""
    group = parser.add_argument_group(
        "photographs without EXIF",
        "For scans, and for photographs by drones, old lenses and programs that leave their focal length out: COLMAP"
        " then need not guess it. EXIF is left as it is. For several cameras write `cameras:` into project.yaml; see"
        " docs/options.md.",
    )
    group.add_argument(
        "--focal-length", type=float, metavar="MM", help="as on the lens, not the 35 mm equivalent"
    )
    group.add_argument(
        "--sensor-width", type=float, metavar="MM", help="along the longer side, as 36 for full frame"
    )


def camera_assignments(parsed: argparse.Namespace) -> list[str]:
    """Return the camera's arguments as assignments of options."""
    given = {"focal_length": parsed.focal_length, "sensor_width": parsed.sensor_width}
    return [f"cameras.*.{name}={value}" for name, value in given.items() if value is not None]


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add what bounds a run: --cluster, --threads, --no-dense, --no-mesh and --strict."""
    add_cluster(parser)
    parser.add_argument(
        "--threads",
        type=count,
        metavar="N",
        help="use at most N cores (all); with 1 the same photographs and options give the same model, bit for bit",
    )
    parser.add_argument("--no-dense", action="store_true", help="end with the sparse model")
    parser.add_argument("--no-mesh", action="store_true", help="end with the dense cloud")
    add_strict(parser)
    add_camera(parser)


def add_strict(parser: argparse.ArgumentParser) -> None:
    """Add --strict."""
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Add --cluster."""
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="work on the workers of this Dask scheduler, as tcp://login1:8786, or on N worker processes here,"
        " local:N; see docs/cluster.md",
    )


def run_assignments(parsed: argparse.Namespace) -> list[str]:
    """Return the arguments of a run as assignments of options."""
    assignments = [*parsed.assignments, *camera_assignments(parsed)]
    if parsed.no_dense:
        assignments.append("dense.enabled=false")
    if parsed.no_mesh:
        assignments.append("mesh.enabled=false")
    if parsed.strict:
        assignments.append("captures.strict=true")
    if parsed.threads:
        assignments.append(f"machine.threads={parsed.threads}")
    if parsed.cluster:
        assignments.append(f"cluster.address={json.dumps(parsed.cluster)}")
    return assignments


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
    group.add_argument("--method", choices=tuple(CONVERSIONS), default="ihe")
    group.add_argument("--weights", type=Path, metavar="FILE", help=weights_help)


def add_development(parser: argparse.ArgumentParser) -> None:
    """Add the options of development of RAW, and --strict."""
    group = parser.add_argument_group("development of RAW, as `develop` in docs/options.md")
    group.add_argument(
        "--calibration", type=Path, metavar="DIR", help="holds bias/, darks/, flats/ or bad-pixels.txt"
    )
    group.add_argument("--demosaic", choices=get_args(Demosaic), default="linear")
    group.add_argument("--green-equilibrium", action=argparse.BooleanOptionalAction, default=True)
    group.add_argument(
        "--find-bad-pixels", action="store_true", help="look for them over the set, without dark frames"
    )
    group.add_argument(
        "--exposure", choices=("as_shot", "normalise"), default="as_shot", help="normalise: by EXIF"
    )
    group.add_argument(
        "--balance", action="store_true", help="colour balance across the set, of any photographs"
    )
    group.add_argument(
        "--denoise",
        type=float,
        default=0.0,
        metavar="N",
        help="in deviations of the noise, of any photographs",
    )
    add_strict(parser)


def development(parsed: argparse.Namespace) -> DevelopOptions:
    """Return the arguments of `add_development` as options."""
    names = DevelopOptions.model_fields
    return load_options(None, [f"develop.{n}={json.dumps(getattr(parsed, n))}" for n in names]).develop
