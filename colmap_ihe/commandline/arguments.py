"""Parse the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from colmap_ihe.commandline import draw_arguments
from colmap_ihe.commandline import shared_arguments as shared
from colmap_ihe.commandline.display import Display
from colmap_ihe.commandline.shared_arguments import Command, add, add_switch
from colmap_ihe.evaluation.tables import METHODS as COMPARED
from colmap_ihe.evaluation.tables import PAPER, SECOND
from colmap_ihe.grey.convert import TONES
from colmap_ihe.machine.libraries import __version__
from colmap_ihe.photographs.encode import SUFFIXES
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.survey.targets import DEFAULT_DICTIONARY

CommandFunction = Callable[[argparse.Namespace, Display], None]


def parser_of(functions: Mapping[str, CommandFunction]) -> argparse.ArgumentParser:
    """Return the parser, which puts the function of a command into `run`."""
    parser = argparse.ArgumentParser(
        prog="colmap-ihe",
        description="Fit one grey conversion to a whole set of photographs, and reconstruct them with COLMAP: cameras, "
        "points, a coloured dense cloud and a mesh.",
        epilog="Exit status: 0 done, 1 failed with one line that says why, 2 wrong usage, 130 stopped.",
    )
    parser.add_argument("-V", "--version", action="version", version=f"colmap-ihe {__version__}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(name: str, text: str) -> argparse.ArgumentParser:
        added = subparsers.add_parser(name, help=text.split(". ")[0].rstrip("."), description=text)
        added.set_defaults(run=functions[name])
        output = added.add_mutually_exclusive_group()
        text = "print the result as JSON, for programs"
        add(output, "--json", text, action="store_const", const="whole")
        text = "print progress, warnings and the result as lines of JSON, as they come"
        add(output, "--json-lines", text, action="store_const", const="lines", dest="json")
        verbosity = added.add_mutually_exclusive_group()
        add_switch(verbosity, "-q --quiet", "no progress, only warnings")
        add_switch(verbosity, "-v --verbose", "also COLMAP's messages, and times")
        return added

    _add_demo(command)
    _add_reconstruct(command)
    _add_batch(command)
    _add_fit(command)
    _add_convert(command)
    _add_develop(command)
    status = command("status", "Say how far each stage of a project is, and why it would run again.")
    shared.add_project(status)
    shared.add_camera(status)
    _add_compare(command)
    draw_arguments.add_draw(command)
    _add_targets(command)
    report = command("report", "Write the page of a project again: PROJECT/report/index.html, one file.")
    shared.add_project(report)
    doctor = command(
        "doctor",
        "Say what this installation and this machine can do; with a PROJECT also how its dense stereo will run, and"
        " its time, memory and disk.",
    )
    shared.add_project(doctor, nargs="?")
    completion = command(
        "completion",
        "Print a script that lets a shell complete commands and options with Tab; see docs/terminal.md.",
    )
    add(completion, "shell", "the shell that is to read it", choices=("bash", "zsh", "fish"))
    subparsers.add_parser("help", help="Show the help of a command, as `help fit`", add_help=False)
    return parser


def _add_demo(command: Command) -> None:
    demo = command(
        "demo",
        "Render a small portico with known truth to RAW and JPEG photographs, reconstruct it like any other "
        "project and print the error against the truth. Needs no download.",
    )
    add(demo, "folder DIR", "where to put it (demo)", nargs="?", default=Path("demo"))
    shared.add_set(demo)


def _add_reconstruct(command: Command) -> None:
    parser = command(
        "reconstruct",
        "Reconstruct the photographs in PROJECT/images: cameras, points, a coloured dense cloud and a mesh in "
        "PROJECT/workspace, a plain COLMAP workspace. The same command goes on after an interruption, and "
        "runs again only what a change makes stale.",
    )
    shared.add_project(parser)
    add(parser, "--from", "run this stage and all after it again", dest="start", choices=STAGE_NAMES)
    add(parser, "--until", "end after this stage", choices=STAGE_NAMES)
    add(parser, "--weights FILE", "take these weights instead of a fit")
    add(
        parser,
        "--from-record PROJECT",
        "take the options of the last run of another project, or of its records/run.json, instead of"
        " project.yaml; says which photographs and versions differ",
    )
    shared.add_run(parser)


def _add_batch(command: Command) -> None:
    parser = command(
        "batch",
        "Reconstruct every project below ROOT, a folder with photographs in images/ each, in a process of its own: one"
        " that fails or crashes does not stop the others. As many at a time as memory has room for."
        " ROOT/batch/index.html shows their state while it runs. The same command goes on with what is missing. Exit"
        " status 1 if not all are done; see docs/batch.md.",
    )
    add(parser, "root ROOT", "the folder that holds the projects")
    add(parser, "--jobs N", "projects at a time, if memory has room (one a core)", type=shared.count)
    text = "of each project, as 90m or 2h; one that takes longer is stopped, and goes on from there next time"
    add(parser, "--time-limit TIME", text, type=shared.duration)
    add_switch(parser, "--watch", "go on with projects that are put into ROOT, until stopped")
    text = "with --watch: begin a project when its files have not changed for so long (30s)"
    add(parser, "--settle TIME", text, type=shared.duration, default=30.0)
    shared.add_set(parser)
    shared.add_run(parser)


def _add_compare(command: Command) -> None:
    parser = command(
        "compare",
        "Evaluate several greys on your photographs as the paper does, side by side. Tables as CSV, JSON"
        " and LaTeX go to PROJECT/compare. The same command goes on after an interruption.",
    )
    shared.add_project(parser)
    text = (
        f"conversions by name; {PAPER} is IHE without the guard, {SECOND} IHE with a second grey where the photographs"
        " need one (%(default)s)"
    )
    add(parser, "--methods NAME,NAME", text, default=",".join(COMPARED))
    text = "runs of the mapper without some of the matches, which tell the error (%(default)s)"
    add(parser, "--seeds N", text, type=int, default=3)
    add_switch(parser, "--no-dense", "without dense clouds")
    add(parser, "--pairs FILE", "measure matching in these pairs instead of all: two photographs a line")


def _add_targets(command: Command) -> None:
    parser = command(
        "targets",
        "Write sheets of coded targets as PDF, in A4 and at true size, with rulers to check the printer by. They are"
        " found in photographs by their names, T0, T1 and so on; see docs/targets.md.",
    )
    add(parser, "--sheet FILE", "the PDF to write", required=True)
    add(parser, "--dictionary NAME", "of OpenCV's aruco", default=DEFAULT_DICTIONARY)
    text = "from edge to edge of the black square, in millimetres"
    add(parser, "--size MM", text, type=float, default=60.0)
    add(parser, "--count N", "how many", type=shared.count, default=12)
    add(parser, "--first K", "number of the first", type=int, default=0)


def _add_fit(command: Command) -> None:
    parser = command(
        "fit",
        "Fit the grey weights of a set of photographs, without COLMAP. IMAGES are folders or files; projects, and "
        "histograms of earlier fits, of which no photograph is read again. See docs/campaigns.md.",
    )
    add(parser, "images IMAGES", "folders, photographs, projects or histograms", nargs="+")
    add(parser, "-o --output FILE", "write the weights, for convert")
    add(parser, "--histogram FILE", "write the histogram, for a later fit over more photographs")
    shared.add_weights(parser, "fit nothing: say whether these weights fit the photographs")
    text = "of ihe; none is the paper to the letter"
    add(parser, "--guard", text, choices=("noise", "none"), default="noise")
    add(parser, "--step", "of the grid of weights", type=float, default=0.01)
    add(parser, "--sample", "part of each side of a photograph to read", type=float, default=1.0)
    text = "let each count the same"
    add(parser, "--weighting", text, choices=("pixel", "image"), default="pixel")
    text = "of RAW: read the photographs a second time, to count grey levels at full depth"
    add(parser, "--recount", text, action=argparse.BooleanOptionalAction, default=True)
    shared.add_development(parser)


def _add_convert(command: Command) -> None:
    parser = command(
        "convert",
        "Convert a folder of photographs to grey images with their EXIF, for any photogrammetry program. Subfolders "
        "are kept. Run again, it writes only what a change makes stale; a file that it did not write is never "
        "overwritten. See docs/use-with.",
    )
    add(parser, "images IMAGES", "a folder of photographs")
    add(parser, "out OUT", "the folder for the grey images")
    add(parser, "--colour DIR", "also a colour image for each grey one, same name and pixels")
    shared.add_weights(parser, "weights of another campaign, from fit -o")
    add(parser, "--format", "of the grey images", choices=tuple(SUFFIXES), default="png")
    add(parser, "--tone", "of RAW photographs", choices=TONES, default="sqrt")
    add_switch(parser, "--wallis", "enhance local contrast; a colour is then not the same grey")
    shared.add_development(parser)
    shared.add_camera(parser)


def _add_develop(command: Command) -> None:
    parser = command(
        "develop",
        "Develop the RAW photographs of a folder to linear TIFFs of 16 bit, as little as possible: black point, "
        "calibration frames, green equilibrium, demosaicing. No white balance, no colour matrix, no gamma. EXIF and "
        "subfolders are kept; run again, it writes only what a change makes stale.",
    )
    add(parser, "images IMAGES", "a folder of photographs")
    add(parser, "out OUT", "the folder for the TIFFs, 6 bytes a pixel")
    shared.add_development(parser)
