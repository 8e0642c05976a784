"""Add the arguments of `draw`, and turn them into what is drawn."""

from __future__ import annotations

import argparse
import json
import re

from colmap_ihe.commandline import shared_arguments as shared
from colmap_ihe.commandline.shared_arguments import Command, add, add_switch
from colmap_ihe.project.option_sections import DrawingView
from colmap_ihe.project.options_file import load_options

_SHAPES = ("plane", "cylinder", "section", "height")
_UNNAMED = "drawing"


def add_draw(command: Command) -> None:
    """Add the command."""
    parser = command(
        "draw",
        "Draw a project that has a mesh into PROJECT/drawings: orthophotos, reliefs, sections and sheets to scale, of"
        " every façade that is found, or of what drawings.views in project.yaml names. Coordinates are those of the"
        " survey; see docs/drawings.md.",
    )
    shared.add_project(parser)
    add(parser, "--view NAME", "only this drawing; with one of the next four, the name of a new one")
    group = parser.add_mutually_exclusive_group()
    text = "auto, x,y,z of a point and of the direction it looks to, or three points"
    add(group, "--plane NUMBERS", text, type=_plane)
    text = "unrolled: x,y,z of a point on its axis and its radius, or that with a direction before the radius"
    add(group, "--cylinder NUMBERS", text, type=_numbers)
    add(group, "--section NUMBERS", "an upright cut along the line x,y,x,y", type=_numbers)
    add(group, "--height Z", "a level cut at a height", type=float)
    add_switch(parser, "--inside", "a cylinder as seen from its axis")
    add(parser, "--mm-per-pixel N", "size of pixels (what the photographs show)", type=float)
    add(parser, "--scale 1:N", "of the sheets (1:50)", type=_scale, metavar="1:N")


def draw_assignments(parsed: argparse.Namespace) -> list[str]:
    """Return the arguments as assignments of options."""
    given = {"mm_per_pixel": parsed.mm_per_pixel, "scale": parsed.scale}
    chosen = [f"drawings.{name}={json.dumps(value)}" for name, value in given.items() if value is not None]
    return [*parsed.assignments, *chosen]


def asked_view(parsed: argparse.Namespace) -> tuple[str, DrawingView | None]:
    """Return the name of what is drawn, empty for all, and the view that the arguments describe, None for one of the
    project's. Raises `OptionError`."""
    name = parsed.view or ""
    shapes = {
        shape: getattr(parsed, shape) for shape in _SHAPES if getattr(parsed, shape) not in (None, "auto")
    }
    if not shapes:
        return name, None
    view = {**shapes, **({"inside": True} if parsed.inside else {})}
    options = load_options(None, [f"drawings.views={json.dumps({name or _UNNAMED: view})}"])
    return name or _UNNAMED, options.drawings.views[name or _UNNAMED]


def _plane(text: str) -> str | list[float]:
    return text if text == "auto" else _numbers(text)


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.replace(" ", ",").split(",") if part]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}, expected numbers with commas between them") from error


def _scale(text: str) -> int:
    match = re.fullmatch(r"(?:1:)?(\d{1,6})", text.strip(), re.ASCII)
    if match is None or not int(match[1]):
        raise argparse.ArgumentTypeError(f"{text!r}, expected a scale such as 1:50")
    return int(match[1])
