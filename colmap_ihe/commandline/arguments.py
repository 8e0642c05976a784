"""What can be said on the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from colmap_ihe.commandline.display import Display
from colmap_ihe.commandline.shared_arguments import (
    Command,
    add_camera,
    add_development,
    add_ends,
    add_project,
    add_set,
    count,
    duration,
)
from colmap_ihe.evaluation.tables import METHODS as COMPARED
from colmap_ihe.evaluation.tables import PAPER
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.convert import TONES
from colmap_ihe.machine.libraries import __version__
from colmap_ihe.photographs.encode import SUFFIXES
from colmap_ihe.pipeline.stages import STAGE_NAMES

METHODS = tuple(CONVERSIONS)
CommandFunction = Callable[[argparse.Namespace, Display], None]


def parser_of(runs: Mapping[str, CommandFunction]) -> argparse.ArgumentParser:
    """The parser, which puts what runs a command into `run`."""
    parser = argparse.ArgumentParser(
        prog="colmap-ihe",
        description="One grey conversion fitted to a whole set of photographs, and the road from them to a "
        "coloured dense cloud with COLMAP.",
        epilog="Exit status: 0 done, 1 failed with one line that says why, 2 wrong usage, 130 stopped.",
    )
    parser.add_argument("--version", action="version", version=f"colmap-ihe {__version__}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(name: str, text: str) -> argparse.ArgumentParser:
        added = subparsers.add_parser(name, help=text.split(". ")[0].rstrip("."), description=text)
        added.set_defaults(run=runs[name])
        shown = added.add_mutually_exclusive_group()
        shown.add_argument(
            "--json", action="store_const", const="whole", help="print the result as JSON, for machines"
        )
        shown.add_argument(
            "--json-lines",
            action="store_const",
            const="lines",
            dest="json",
            help="print progress, warnings and the result as lines of JSON, as they come",
        )
        loud = added.add_mutually_exclusive_group()
        loud.add_argument("-q", "--quiet", action="store_true", help="no progress, only warnings")
        loud.add_argument("-v", "--verbose", action="store_true", help="also what COLMAP says, and times")
        return added

    _add_demo(command)
    _add_reconstruct(command)
    _add_batch(command)
    _add_fit(command)
    _add_convert(command)
    _add_develop(command)
    one = command("status", "Where each stage of a project stands, and why it would run again.")
    add_project(one)
    add_camera(one)
    _add_compare(command)
    page = command("report", "Writes the page of a project again: PROJECT/report/index.html, one file.")
    add_project(page)
    doctor = command(
        "doctor",
        "What this installation and this machine can do; with a PROJECT also how its dense stereo will run, and what"
        " that takes in time, memory and disk.",
    )
    add_project(doctor, nargs="?")
    return parser


def _add_demo(command: Command) -> None:
    demo = command(
        "demo",
        "Renders a small portico with known truth to RAW and JPEG photographs, reconstructs it like any other "
        "project and prints the error against the truth. Needs no download.",
    )
    demo.add_argument(
        "folder", type=Path, nargs="?", default=Path("demo"), metavar="DIR", help="where to put it (demo)"
    )
    demo.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="STAGE.OPTION=VALUE",
        dest="assignments",
        help="change an option",
    )


def _add_reconstruct(command: Command) -> None:
    parser = command(
        "reconstruct",
        "From the photographs in PROJECT/images to cameras, points, a coloured dense cloud and a mesh in "
        "PROJECT/workspace, a plain COLMAP workspace. The same command goes on after an interruption, and "
        "runs again only what a change makes stale.",
    )
    add_project(parser)
    parser.add_argument(
        "--from", dest="start", choices=STAGE_NAMES, help="run this stage and all after it again"
    )
    parser.add_argument("--until", choices=STAGE_NAMES, help="end after this stage")
    parser.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help="weights of another campaign, instead of a fit to this one",
    )
    add_ends(parser)
    parser.add_argument(
        "--from-record",
        type=Path,
        metavar="PROJECT",
        help="with the options of the last run of another project, or of its records/run.json, instead of"
        " project.yaml; says what is unlike: photographs, versions",
    )
    add_camera(parser)


def _add_batch(command: Command) -> None:
    parser = command(
        "batch",
        "Every project below ROOT, a folder with photographs in images/ each, in a process of its own: one that fails"
        " or crashes does not stop the others. As many at a time as memory has room for. ROOT/batch/index.html shows"
        " what they have come to while it runs. The same command goes on with what is missing. Exit status 1 if not all"
        " are done; see docs/batch.md.",
    )
    parser.add_argument("root", type=Path, metavar="ROOT", help="the folder that holds the projects")
    parser.add_argument(
        "--jobs", type=count, metavar="N", help="projects at a time, if memory has room (one a core)"
    )
    parser.add_argument(
        "--time-limit",
        type=duration,
        metavar="TIME",
        help="for each project, as 90m or 2h; one that takes longer is stopped, and goes on from there next time",
    )
    parser.add_argument(
        "--watch", action="store_true", help="go on with projects that are put into ROOT, until stopped"
    )
    parser.add_argument(
        "--settle",
        type=duration,
        default=30.0,
        metavar="TIME",
        help="with --watch: for how long a project's files must not have changed before it begins (30s)",
    )
    add_set(parser)
    add_ends(parser)
    add_camera(parser)


def _add_compare(command: Command) -> None:
    parser = command(
        "compare",
        "The paper's evaluation on your photographs: the same set in several greys, side by side. Tables as CSV, JSON"
        " and LaTeX go to PROJECT/compare. The same command goes on after an interruption.",
    )
    add_project(parser)
    parser.add_argument(
        "--methods",
        default=",".join(COMPARED),
        metavar="NAME,NAME",
        help=f"conversions by name; {PAPER} is IHE without the guard (%(default)s)",
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=3,
        metavar="N",
        help="runs of the mapper without some of the matches, which tell the error (%(default)s)",
    )
    parser.add_argument("--no-dense", action="store_true", help="without dense clouds")
    parser.add_argument(
        "--pairs",
        type=Path,
        metavar="FILE",
        help="measure matching in these pairs instead of all: two photographs a line",
    )


def _add_fit(command: Command) -> None:
    parser = command(
        "fit",
        "The grey weights of a set of photographs, without COLMAP. IMAGES are folders or files; projects, and "
        "histograms of earlier fits, of which no photograph is read again. See docs/campaigns.md.",
    )
    parser.add_argument("images", type=Path, nargs="+", metavar="IMAGES")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the weights, for convert")
    parser.add_argument(
        "--histogram",
        type=Path,
        metavar="FILE",
        help="write what was counted, for a later fit over more photographs",
    )
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--method", choices=METHODS, default="ihe")
    chosen.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help="fit nothing: tell whether these weights fit the photographs",
    )
    parser.add_argument(
        "--guard", choices=("noise", "none"), default="noise", help="of ihe; none is the paper to the letter"
    )
    parser.add_argument("--step", type=float, default=0.01, help="of the grid of weights (0.01)")
    parser.add_argument("--sample", type=float, default=1.0, help="of each side of a photograph (1)")
    parser.add_argument(
        "--weighting", choices=("pixel", "image"), default="pixel", help="what counts equally"
    )
    parser.add_argument(
        "--recount",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="of RAW: read the photographs a second time, to count grey levels at full depth",
    )
    add_development(parser)
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")


def _add_convert(command: Command) -> None:
    parser = command(
        "convert",
        "Grey images of a folder of photographs, with their EXIF, for any photogrammetry program. Subfolders "
        "are kept. Run again, it writes only what a change makes stale; a file that it did not write is never "
        "overwritten. See docs/use-with.",
    )
    parser.add_argument("images", type=Path, metavar="IMAGES", help="a folder of photographs")
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder for the grey images")
    parser.add_argument(
        "--colour",
        type=Path,
        metavar="DIR",
        help="also a colour twin of each grey image, same name and pixels, for texture",
    )
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--method", choices=METHODS, default="ihe")
    chosen.add_argument(
        "--weights", type=Path, metavar="FILE", help="weights of another campaign, from fit -o"
    )
    parser.add_argument("--format", choices=tuple(SUFFIXES), default="png")
    parser.add_argument("--tone", choices=TONES, default="sqrt", help="of RAW photographs")
    parser.add_argument(
        "--wallis", action="store_true", help="enhance local contrast; a colour is then not the same grey"
    )
    add_development(parser)
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")
    add_camera(parser)


def _add_develop(command: Command) -> None:
    parser = command(
        "develop",
        "The RAW photographs of a folder as linear TIFFs of 16 bit, developed as little as possible: black point, "
        "calibration frames, green equilibrium, demosaicing. No white balance, no colour matrix, no gamma. EXIF and "
        "subfolders are kept; run again, it writes only what a change makes stale.",
    )
    parser.add_argument("images", type=Path, metavar="IMAGES", help="a folder of photographs")
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder for the TIFFs, 6 bytes a pixel")
    add_development(parser)
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")
