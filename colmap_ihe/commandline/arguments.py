"""Parse the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from colmap_ihe.commandline.display import Display
from colmap_ihe.commandline.shared_arguments import (
    Command,
    add_camera,
    add_development,
    add_project,
    add_run,
    add_set,
    add_weights,
    count,
    duration,
)
from colmap_ihe.evaluation.tables import METHODS as COMPARED
from colmap_ihe.evaluation.tables import PAPER
from colmap_ihe.grey.convert import TONES
from colmap_ihe.machine.libraries import __version__
from colmap_ihe.photographs.encode import SUFFIXES
from colmap_ihe.pipeline.stages import STAGE_NAMES

CommandFunction = Callable[[argparse.Namespace, Display], None]


def parser_of(functions: Mapping[str, CommandFunction]) -> argparse.ArgumentParser:
    """Return the parser, which puts the function of a command into `run`."""
    parser = argparse.ArgumentParser(
        prog="colmap-ihe",
        description="Fit one grey conversion to a whole set of photographs, and reconstruct them with COLMAP: cameras, "
        "points, a coloured dense cloud and a mesh.",
        epilog="Exit status: 0 done, 1 failed with one line that says why, 2 wrong usage, 130 stopped.",
    )
    parser.add_argument("--version", action="version", version=f"colmap-ihe {__version__}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(name: str, text: str) -> argparse.ArgumentParser:
        added = subparsers.add_parser(name, help=text.split(". ")[0].rstrip("."), description=text)
        added.set_defaults(run=functions[name])
        output = added.add_mutually_exclusive_group()
        output.add_argument(
            "--json", action="store_const", const="whole", help="print the result as JSON, for programs"
        )
        output.add_argument(
            "--json-lines",
            action="store_const",
            const="lines",
            dest="json",
            help="print progress, warnings and the result as lines of JSON, as they come",
        )
        verbosity = added.add_mutually_exclusive_group()
        verbosity.add_argument("-q", "--quiet", action="store_true", help="no progress, only warnings")
        verbosity.add_argument(
            "-v", "--verbose", action="store_true", help="also COLMAP's messages, and times"
        )
        return added

    _add_demo(command)
    _add_reconstruct(command)
    _add_batch(command)
    _add_fit(command)
    _add_convert(command)
    _add_develop(command)
    status = command("status", "Say how far each stage of a project is, and why it would run again.")
    add_project(status)
    add_camera(status)
    _add_compare(command)
    add_project(command("report", "Write the page of a project again: PROJECT/report/index.html, one file."))
    doctor = command(
        "doctor",
        "Say what this installation and this machine can do; with a PROJECT also how its dense stereo will run, and"
        " its time, memory and disk.",
    )
    add_project(doctor, nargs="?")
    return parser


def _add_demo(command: Command) -> None:
    demo = command(
        "demo",
        "Render a small portico with known truth to RAW and JPEG photographs, reconstruct it like any other "
        "project and print the error against the truth. Needs no download.",
    )
    demo.add_argument(
        "folder", type=Path, nargs="?", default=Path("demo"), metavar="DIR", help="where to put it (demo)"
    )
    add_set(demo)


def _add_reconstruct(command: Command) -> None:
    parser = command(
        "reconstruct",
        "Reconstruct the photographs in PROJECT/images: cameras, points, a coloured dense cloud and a mesh in "
        "PROJECT/workspace, a plain COLMAP workspace. The same command goes on after an interruption, and "
        "runs again only what a change makes stale.",
    )
    add_project(parser)
    parser.add_argument(
        "--from", dest="start", choices=STAGE_NAMES, help="run this stage and all after it again"
    )
    parser.add_argument("--until", choices=STAGE_NAMES, help="end after this stage")
    parser.add_argument("--weights", type=Path, metavar="FILE", help="take these weights instead of a fit")
    parser.add_argument(
        "--from-record",
        type=Path,
        metavar="PROJECT",
        help="take the options of the last run of another project, or of its records/run.json, instead of"
        " project.yaml; says which photographs and versions differ",
    )
    add_run(parser)


def _add_batch(command: Command) -> None:
    parser = command(
        "batch",
        "Reconstruct every project below ROOT, a folder with photographs in images/ each, in a process of its own: one"
        " that fails or crashes does not stop the others. As many at a time as memory has room for."
        " ROOT/batch/index.html shows their state while it runs. The same command goes on with what is missing. Exit"
        " status 1 if not all are done; see docs/batch.md.",
    )
    parser.add_argument("root", type=Path, metavar="ROOT", help="the folder that holds the projects")
    parser.add_argument(
        "--jobs", type=count, metavar="N", help="projects at a time, if memory has room (one a core)"
    )
    parser.add_argument(
        "--time-limit",
        type=duration,
        metavar="TIME",
        help="of each project, as 90m or 2h; one that takes longer is stopped, and goes on from there next time",
    )
    parser.add_argument(
        "--watch", action="store_true", help="go on with projects that are put into ROOT, until stopped"
    )
    parser.add_argument(
        "--settle",
        type=duration,
        default=30.0,
        metavar="TIME",
        help="with --watch: begin a project when its files have not changed for so long (30s)",
    )
    add_set(parser)
    add_run(parser)


def _add_compare(command: Command) -> None:
    parser = command(
        "compare",
        "Evaluate several greys on your photographs as the paper does, side by side. Tables as CSV, JSON"
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
        "Fit the grey weights of a set of photographs, without COLMAP. IMAGES are folders or files; projects, and "
        "histograms of earlier fits, of which no photograph is read again. See docs/campaigns.md.",
    )
    parser.add_argument("images", type=Path, nargs="+", metavar="IMAGES")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the weights, for convert")
    parser.add_argument(
        "--histogram",
        type=Path,
        metavar="FILE",
        help="write the histogram, for a later fit over more photographs",
    )
    add_weights(parser, "fit nothing: say whether these weights fit the photographs")
    parser.add_argument(
        "--guard", choices=("noise", "none"), default="noise", help="of ihe; none is the paper to the letter"
    )
    parser.add_argument("--step", type=float, default=0.01, help="of the grid of weights (0.01)")
    parser.add_argument(
        "--sample", type=float, default=1.0, help="part of each side of a photograph to read (1)"
    )
    parser.add_argument(
        "--weighting", choices=("pixel", "image"), default="pixel", help="let each count the same (pixel)"
    )
    parser.add_argument(
        "--recount",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="of RAW: read the photographs a second time, to count grey levels at full depth",
    )
    add_development(parser)


def _add_convert(command: Command) -> None:
    parser = command(
        "convert",
        "Convert a folder of photographs to grey images with their EXIF, for any photogrammetry program. Subfolders "
        "are kept. Run again, it writes only what a change makes stale; a file that it did not write is never "
        "overwritten. See docs/use-with.",
    )
    parser.add_argument("images", type=Path, metavar="IMAGES", help="a folder of photographs")
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder for the grey images")
    parser.add_argument(
        "--colour",
        type=Path,
        metavar="DIR",
        help="also a colour image for each grey one, same name and pixels",
    )
    add_weights(parser, "weights of another campaign, from fit -o")
    parser.add_argument("--format", choices=tuple(SUFFIXES), default="png")
    parser.add_argument("--tone", choices=TONES, default="sqrt", help="of RAW photographs")
    parser.add_argument(
        "--wallis", action="store_true", help="enhance local contrast; a colour is then not the same grey"
    )
    add_development(parser)
    add_camera(parser)


def _add_develop(command: Command) -> None:
    parser = command(
        "develop",
        "Develop the RAW photographs of a folder to linear TIFFs of 16 bit, as little as possible: black point, "
        "calibration frames, green equilibrium, demosaicing. No white balance, no colour matrix, no gamma. EXIF and "
        "subfolders are kept; run again, it writes only what a change makes stale.",
    )
    parser.add_argument("images", type=Path, metavar="IMAGES", help="a folder of photographs")
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder for the TIFFs, 6 bytes a pixel")
    add_development(parser)
