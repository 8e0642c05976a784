"""The command line: parse, call, print. The only place that configures logging and listens to signals."""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

from colmap_ihe import commands
from colmap_ihe.captures.encode import SUFFIXES
from colmap_ihe.captures.recipe import Demosaic
from colmap_ihe.errors import Cancelled, KnownError
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.convert import TONES
from colmap_ihe.grey.weights import Weights
from colmap_ihe.grey_folder import convert_folder
from colmap_ihe.linear_folder import develop_folder
from colmap_ihe.options import ConvertOptions, DevelopOptions, FitOptions, load_options
from colmap_ihe.pipeline import NAMES, reconstruct, status
from colmap_ihe.report.summary import weights_in_words
from colmap_ihe.terminal import Bars, print_summary, print_table
from colmap_ihe.version import __version__

METHODS = tuple(CONVERSIONS)
EXIT_FAILED, EXIT_CANCELLED = 1, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit status: 0 done, 1 a known failure, 130 cancelled. Wrong usage
    exits with 2."""
    parsed = _parser().parse_args(arguments)
    warnings.filterwarnings("ignore", module=r"PIL\b")  # of broken photographs, which we name ourselves
    logging.basicConfig(level=logging.WARNING, format="%(name)s: %(message)s", stream=sys.stderr)
    bars = Bars(quiet=parsed.quiet)
    before = _listen(bars)
    try:
        run: Callable[[argparse.Namespace, Bars], None] = parsed.run
        run(parsed, bars)
        sys.stdout.flush()
    except KnownError as error:
        hint = f" ({error.hint})" if error.hint else ""
        print(f"colmap-ihe: {error}{hint}", file=sys.stderr)
        return EXIT_FAILED
    except (Cancelled, KeyboardInterrupt):
        same = "without --from, it" if getattr(parsed, "start", None) else "the same command"
        print(f"colmap-ihe: stopped; {same} goes on from here", file=sys.stderr)
        return EXIT_CANCELLED
    except BrokenPipeError:
        _drop_stdout()
    except OSError as error:
        _drop_stdout()
        place = f"{error.filename}: " if error.filename else ""
        print(f"colmap-ihe: {place}{error.strerror or error}", file=sys.stderr)
        return EXIT_FAILED
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _drop_stdout() -> None:
    """What could not be printed is not tried again as the process ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _listen(bars: Bars) -> dict[int, Any]:
    """The first Ctrl-C or SIGTERM asks what is running to stop; a second one does not ask."""

    def on_signal(number: int, _frame: object) -> None:
        bars.stop()
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)

    return {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="colmap-ihe",
        description="One grey conversion fitted to a whole set of photographs, and the road from them to a "
        "coloured dense cloud with COLMAP.",
        epilog="Exit status: 0 done, 1 failed with one line that says why, 2 wrong usage, 130 stopped.",
    )
    parser.add_argument("--version", action="version", version=f"colmap-ihe {__version__}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(
        name: str, run: Callable[[argparse.Namespace, Bars], None], text: str
    ) -> argparse.ArgumentParser:
        added = subparsers.add_parser(name, help=text.split(". ")[0].rstrip("."), description=text)
        added.set_defaults(run=run)
        added.add_argument("--json", action="store_true", help="print the result as JSON, for machines")
        added.add_argument("-q", "--quiet", action="store_true", help="no progress, only warnings")
        return added

    _add_demo(command)
    _add_reconstruct(command)
    _add_fit(command)
    _add_convert(command)
    _add_develop(command)
    one = command("status", _status, "Where each stage of a project stands, and why it would run again.")
    _add_project(one)
    _add_camera(one)
    command("doctor", _doctor, "What this installation and this machine can do.")
    return parser


_Command = Callable[[str, Callable[[argparse.Namespace, Bars], None], str], argparse.ArgumentParser]


def _add_project(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("project", type=Path, metavar="PROJECT", help="the project's folder")
    parser.add_argument("--images", type=Path, metavar="DIR", help="photographs, if not in PROJECT/images")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="STAGE.OPTION=VALUE",
        dest="assignments",
        help="change an option, as in --set dense.max_image_size=2400; see docs/options.md",
    )


def _add_camera(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "photographs without EXIF",
        "For scans, and for photographs by drones, old lenses and programs that leave their focal length out: the"
        " grey images say what is given here, and COLMAP need not guess. What EXIF says is left as it is. For"
        " several cameras write `cameras:` into project.yaml; see docs/options.md.",
    )
    group.add_argument(
        "--focal-length", type=float, metavar="MM", help="as on the lens, not the 35 mm equivalent"
    )
    group.add_argument(
        "--sensor-width",
        type=float,
        metavar="MM",
        help="of the sensor along the longer side of the photographs, as 36 of full frame",
    )


def _camera_assignments(parsed: argparse.Namespace) -> list[str]:
    given = {"focal_length": parsed.focal_length, "sensor_width": parsed.sensor_width}
    return [f"cameras.*.{name}={value}" for name, value in given.items() if value is not None]


def _add_demo(command: _Command) -> None:
    demo = command(
        "demo",
        _demo,
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


def _add_reconstruct(command: _Command) -> None:
    parser = command(
        "reconstruct",
        _reconstruct,
        "From the photographs in PROJECT/images to cameras, points and a coloured dense cloud in "
        "PROJECT/workspace, a plain COLMAP workspace. The same command goes on after an interruption, and "
        "runs again only what a change makes stale.",
    )
    _add_project(parser)
    parser.add_argument("--from", dest="start", choices=NAMES, help="run this stage and all after it again")
    parser.add_argument("--until", choices=NAMES, help="end after this stage")
    parser.add_argument("--no-dense", action="store_true", help="end with the sparse model")
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")
    _add_camera(parser)


def _add_fit(command: _Command) -> None:
    parser = command(
        "fit", _fit, "The grey weights of a set of photographs, without COLMAP. IMAGES are folders or files."
    )
    parser.add_argument("images", type=Path, nargs="+", metavar="IMAGES")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the weights, for convert")
    parser.add_argument("--method", choices=METHODS, default="ihe")
    parser.add_argument(
        "--guard", choices=("noise", "none"), default="noise", help="of ihe; none is the paper to the letter"
    )
    parser.add_argument("--step", type=float, default=0.01, help="of the grid of weights (0.01)")
    parser.add_argument("--sample", type=float, default=1.0, help="of each side of a photograph (1)")
    parser.add_argument(
        "--weighting", choices=("pixel", "image"), default="pixel", help="what counts equally"
    )
    _add_development(parser)
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")


def _add_convert(command: _Command) -> None:
    parser = command(
        "convert",
        _convert,
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
    _add_development(parser)
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")
    _add_camera(parser)


def _add_develop(command: _Command) -> None:
    parser = command(
        "develop",
        _develop,
        "The RAW photographs of a folder as linear TIFFs of 16 bit, developed as little as possible: black point, "
        "calibration frames, green equilibrium, demosaicing. No white balance, no colour matrix, no gamma. EXIF and "
        "subfolders are kept; run again, it writes only what a change makes stale.",
    )
    parser.add_argument("images", type=Path, metavar="IMAGES", help="a folder of photographs")
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder for the TIFFs, 6 bytes a pixel")
    _add_development(parser)
    parser.add_argument("--strict", action="store_true", help="stop at a photograph that cannot be used")


def _add_development(parser: argparse.ArgumentParser) -> None:
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


def _development(parsed: argparse.Namespace) -> DevelopOptions:
    names = DevelopOptions.model_fields
    return load_options(None, [f"develop.{n}={json.dumps(getattr(parsed, n))}" for n in names]).develop


def _develop(parsed: argparse.Namespace, bars: Bars) -> None:
    names, steps, left_out = develop_folder(
        parsed.images,
        parsed.out,
        options=_development(parsed),
        calibration=parsed.calibration,
        strict=parsed.strict,
        audience=bars,
    )
    if parsed.json:
        _print_json({"linear": names, "steps": steps, "left_out": left_out})
        return
    print(f"{len(names)} linear TIFFs in {parsed.out}")
    for camera, done in steps.items():
        print(f"{camera}: {', '.join(done)}")


def _reconstruct(parsed: argparse.Namespace, bars: Bars) -> None:
    assignments = [*parsed.assignments, *_camera_assignments(parsed)]
    if parsed.no_dense:
        assignments.append("dense.enabled=false")
    if parsed.strict:
        assignments.append("captures.strict=true")
    options = commands.project_options(parsed.project, assignments)
    done = reconstruct(
        parsed.project, options, images=parsed.images, start=parsed.start, until=parsed.until, audience=bars
    )
    if parsed.json:
        _print_json(dict(done.summary))
        return
    print_summary(done.summary, title=str(parsed.project))
    print(f"report    {done.project.summary_file}")
    for name, place in (("sparse", done.sparse_model), ("dense", done.dense_cloud)):
        if place.exists() and done.summary["stages"].get(name) is not None:
            print(f"{name:<9} {place}")


def _demo(parsed: argparse.Namespace, bars: Bars) -> None:
    done = commands.demo(parsed.folder, parsed.assignments, bars)
    if parsed.json:
        _print_json(dict(done.summary))
    else:
        print_summary(done.summary, title=f"demo in {parsed.folder}")
        print(f"report    {done.project.summary_file}")
        print(f"dense     {done.dense_cloud}")


def _fit(parsed: argparse.Namespace, bars: Bars) -> None:
    names = ("method", "guard", "step", "sample", "weighting")
    assignments = [f"fit.{name}={getattr(parsed, name)}" for name in names]
    options = load_options(None, assignments).fit
    weights, left_out = commands.fit_files(
        parsed.images,
        options,
        output=parsed.output,
        develop=_development(parsed),
        calibration=parsed.calibration,
        strict=parsed.strict,
        audience=bars,
    )
    result = {**weights.as_dict(), "left_out": left_out}
    if parsed.json:
        _print_json(result)
        return
    for reason in left_out.values():
        bars.warn(f"left out: {reason}")
    print_table(
        "",
        [
            (name, ", ".join(map(str, v)) if isinstance(v, list) else str(v))
            for name, v in weights.as_dict().items()
            if name != "curve"
        ],
    )


def _convert(parsed: argparse.Namespace, bars: Bars) -> None:
    weights, grey, left_out = convert_folder(
        parsed.images,
        parsed.out,
        colour=parsed.colour,
        fit=FitOptions(method=parsed.method),
        weights=commands.read_weights(parsed.weights) if parsed.weights else None,
        options=ConvertOptions(tone=parsed.tone, wallis=parsed.wallis, format=parsed.format),
        develop=_development(parsed),
        calibration=parsed.calibration,
        cameras=load_options(None, _camera_assignments(parsed)).cameras,
        strict=parsed.strict,
        audience=bars,
    )
    if parsed.json:
        _print_json({**weights.as_dict(), "grey": grey, "left_out": left_out})
    else:
        words = f": {weights_in_words(weights.triplet)}" if isinstance(weights, Weights) else ""
        print(f"{len(grey)} grey images in {parsed.out} ({weights.method}{words})")


def _status(parsed: argparse.Namespace, _bars: Bars) -> None:
    options = commands.project_options(parsed.project, [*parsed.assignments, *_camera_assignments(parsed)])
    states = status(parsed.project, options, parsed.images)
    if parsed.json:
        _print_json([asdict(state) for state in states])
        return
    rows = [(s.name, s.state, "" if s.seconds is None else f"{s.seconds:.0f} s", s.why) for s in states]
    print_table("", rows, ("stage", "state", "time", "why"))


def _doctor(parsed: argparse.Namespace, _bars: Bars) -> None:
    found = commands.doctor()
    if parsed.json:
        _print_json(found)
    else:
        print_table("", [(name, str(value)) for name, value in found.items()])


def _print_json(values: Any) -> None:
    print(json.dumps(values, indent=2, ensure_ascii=False))


def entry_point() -> None:
    status_code = main()
    sys.stderr.flush()
    # A mapper that cannot be asked to stop may still be on its thread: Python's own exit would wait for it.
    if status_code == EXIT_CANCELLED:
        os._exit(EXIT_CANCELLED)
    sys.exit(status_code)


if __name__ == "__main__":
    entry_point()
