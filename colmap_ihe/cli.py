"""The command line: call what `arguments` parsed, and print. The only place that configures logging and signals."""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from colmap_ihe import commands
from colmap_ihe.arguments import Run, camera_assignments, development, parser_of
from colmap_ihe.compare import compare
from colmap_ihe.compared import sentences, tables_of
from colmap_ihe.errors import Cancelled, KnownError
from colmap_ihe.grey.weights import Weights
from colmap_ihe.grey_folder import convert_folder
from colmap_ihe.linear_folder import develop_folder
from colmap_ihe.options import ConvertOptions, FitOptions
from colmap_ihe.pipeline import Reconstruction, reconstruct, status
from colmap_ihe.project_yaml import load_options
from colmap_ihe.report.summary import weights_in_words
from colmap_ihe.terminal import Bars, print_summary, print_table

EXIT_FAILED, EXIT_CANCELLED = 1, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit status: 0 done, 1 a known failure, 130 cancelled. Wrong usage
    exits with 2."""
    parsed = parser_of(_RUNS).parse_args(arguments)
    warnings.filterwarnings("ignore", module=r"PIL\b")  # of broken photographs, which we name ourselves
    logging.basicConfig(level=logging.WARNING, format="%(name)s: %(message)s", stream=sys.stderr)
    bars = Bars(quiet=parsed.quiet)
    before = _listen(bars)
    try:
        run: Run = parsed.run
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


def _develop(parsed: argparse.Namespace, bars: Bars) -> None:
    names, steps, left_out = develop_folder(
        parsed.images,
        parsed.out,
        options=development(parsed),
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
    assignments = [*parsed.assignments, *camera_assignments(parsed)]
    if parsed.no_dense:
        assignments.append("dense.enabled=false")
    if parsed.no_mesh:
        assignments.append("mesh.enabled=false")
    if parsed.strict:
        assignments.append("captures.strict=true")
    if parsed.cluster:
        assignments.append(f"cluster.address={json.dumps(parsed.cluster)}")
    options = commands.project_options(parsed.project, assignments)
    done = reconstruct(
        parsed.project, options, images=parsed.images, start=parsed.start, until=parsed.until, audience=bars
    )
    if parsed.json:
        _print_json(dict(done.summary))
        return
    print_summary(done.summary, title=str(parsed.project))
    _print_report(done)
    for name, place in (("sparse", done.sparse_model), ("dense", done.dense_cloud), ("mesh", done.mesh)):
        if place.exists() and done.summary["stages"].get(name) is not None:
            print(f"{name:<9} {place}")


def _print_report(done: Reconstruction) -> None:
    """The page, or where the run ended before it the summary."""
    page = done.project.page_file
    print(f"report    {page if page.exists() else done.project.summary_file}")


def _demo(parsed: argparse.Namespace, bars: Bars) -> None:
    done = commands.demo(parsed.folder, parsed.assignments, bars)
    if parsed.json:
        _print_json(dict(done.summary))
    else:
        print_summary(done.summary, title=f"demo in {parsed.folder}")
        _print_report(done)
        print(f"dense     {done.dense_cloud}")


def _fit(parsed: argparse.Namespace, bars: Bars) -> None:
    names = ("method", "guard", "step", "sample", "weighting")
    assignments = [f"fit.{name}={getattr(parsed, name)}" for name in names]
    options = load_options(None, assignments).fit
    weights, left_out = commands.fit_files(
        parsed.images,
        options,
        output=parsed.output,
        develop=development(parsed),
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
        develop=development(parsed),
        calibration=parsed.calibration,
        cameras=load_options(None, camera_assignments(parsed)).cameras,
        strict=parsed.strict,
        audience=bars,
    )
    if parsed.json:
        _print_json({**weights.as_dict(), "grey": grey, "left_out": left_out})
    else:
        words = f": {weights_in_words(weights.triplet)}" if isinstance(weights, Weights) else ""
        print(f"{len(grey)} grey images in {parsed.out} ({weights.method}{words})")


def _status(parsed: argparse.Namespace, _bars: Bars) -> None:
    options = commands.project_options(parsed.project, [*parsed.assignments, *camera_assignments(parsed)])
    states = status(parsed.project, options, parsed.images)
    if parsed.json:
        _print_json([asdict(state) for state in states])
        return
    rows = [(s.name, s.state, "" if s.seconds is None else f"{s.seconds:.0f} s", s.why) for s in states]
    print_table("", rows, ("stage", "state", "time", "why"))


def _compare(parsed: argparse.Namespace, bars: Bars) -> None:
    assignments = [*parsed.assignments, *(["dense.enabled=false"] if parsed.no_dense else [])]
    found = compare(
        parsed.project,
        commands.project_options(parsed.project, assignments),
        methods=[name.strip() for name in parsed.methods.split(",") if name.strip()],
        seeds=parsed.seeds,
        images=parsed.images,
        audience=bars,
    )
    if parsed.json:
        _print_json([asdict(one) for one in found])
        return
    for table in tables_of(found):
        print_table(table.title, [tuple(row) for row in table.rows], tuple(table.columns))
    for sentence in sentences(found):
        print(sentence)
    print(f"report    {parsed.project / 'compare' / 'index.html'}")


def _report(parsed: argparse.Namespace, bars: Bars) -> None:
    page = commands.report(parsed.project, parsed.assignments, parsed.images, bars)
    if parsed.json:
        _print_json({"page": str(page)})
    else:
        print(page)


def _doctor(parsed: argparse.Namespace, _bars: Bars) -> None:
    found = commands.doctor(parsed.project, parsed.assignments, parsed.images)
    if parsed.json:
        _print_json(found)
    else:
        print_table("", [(name, str(value)) for name, value in found.items()])


def _print_json(values: Any) -> None:
    print(json.dumps(values, indent=2, ensure_ascii=False))


_RUNS: dict[str, Run] = {
    "demo": _demo,
    "reconstruct": _reconstruct,
    "fit": _fit,
    "convert": _convert,
    "develop": _develop,
    "status": _status,
    "compare": _compare,
    "report": _report,
    "doctor": _doctor,
}


def entry_point() -> None:
    status_code = main()
    sys.stderr.flush()
    # A mapper that cannot be asked to stop may still be on its thread: Python's own exit would wait for it.
    if status_code == EXIT_CANCELLED:
        os._exit(EXIT_CANCELLED)
    sys.exit(status_code)


if __name__ == "__main__":
    entry_point()
