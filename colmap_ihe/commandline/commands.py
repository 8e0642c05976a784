"""Run each command, and print its result: plain words, tables, or JSON."""

from __future__ import annotations

import argparse
import json
import shlex
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import shtab

from colmap_ihe.batch.driver import batch
from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.commandline.arguments import CommandFunction, parser_of
from colmap_ihe.commandline.bars import print_batch, print_summary, print_table
from colmap_ihe.commandline.display import Display, printable
from colmap_ihe.commandline.draw_arguments import asked_view, draw_assignments
from colmap_ihe.commandline.shared_arguments import camera_assignments, development, run_assignments
from colmap_ihe.errors import KnownError
from colmap_ihe.evaluation.compare import compare
from colmap_ihe.evaluation.demo.run import demo
from colmap_ihe.evaluation.tables import sentences, tables_of
from colmap_ihe.fit.weights_file import read_weights
from colmap_ihe.grey.weights import Weights
from colmap_ihe.machine.cluster.connect import connected
from colmap_ihe.pipeline.convert_folder import convert_folder, tried_in
from colmap_ihe.pipeline.develop_folder import develop_folder
from colmap_ihe.pipeline.doctor import doctor
from colmap_ihe.pipeline.draw_project import draw
from colmap_ihe.pipeline.fit_files import fit_files
from colmap_ihe.pipeline.reconstruct import EndedEarlyError, Reconstruction, reconstruct
from colmap_ihe.pipeline.repeat import read_run
from colmap_ihe.pipeline.status import status
from colmap_ihe.pipeline.summary import report
from colmap_ihe.project.option_sections import ClusterOptions
from colmap_ihe.project.options import ConvertOptions, FitOptions
from colmap_ihe.project.options_file import load_options, project_options
from colmap_ihe.report.tables import weights_in_words
from colmap_ihe.survey.sheet import write_sheet
from colmap_ihe.survey.targets import target_name


def _develop(parsed: argparse.Namespace, display: Display) -> None:
    names, steps, left_out = develop_folder(
        parsed.images,
        parsed.out,
        options=development(parsed),
        calibration=parsed.calibration,
        strict=parsed.strict,
        progress=display,
    )
    if _printed_as_json(parsed, display, {"linear": names, "steps": steps, "left_out": left_out}):
        return
    print(f"{len(names)} linear TIFFs in {parsed.out}")
    for camera, done in steps.items():
        print(printable(f"{camera}: {', '.join(done)}"))


def _reconstruct(parsed: argparse.Namespace, display: Display) -> None:
    assignments = run_assignments(parsed)
    if parsed.weights:
        assignments.append(f"fit.weights={json.dumps(str(parsed.weights.absolute()))}")
    record = read_run(parsed.from_record, assignments) if parsed.from_record else None
    try:
        done = reconstruct(
            parsed.project,
            record.options if record else project_options(parsed.project, assignments),
            images=parsed.images,
            start=parsed.start,
            until=parsed.until,
            progress=display,
            noted=record,
        )
    except EndedEarlyError as error:
        _print_reconstruction(parsed, display, error.done)
        raise
    _print_reconstruction(parsed, display, done)


def _print_reconstruction(parsed: argparse.Namespace, display: Display, done: Reconstruction) -> None:
    if _printed_as_json(parsed, display, dict(done.summary)):
        return
    _print_made(done, str(parsed.project))


def _print_made(done: Reconstruction, title: str) -> None:
    """Print the summary of a run, and where what it made is: its page, or of one that ended before it the summary."""
    print_summary(done.summary, title=title)
    print(f"report    {done.page or done.project.summary_file}")
    mesh = done.textured_mesh or done.mesh
    calibration = done.project.calibration_file
    if done.summary["cameras"] and calibration.exists():
        print(f"cameras   {calibration}")
    for name, path in (("sparse", done.sparse_model), ("dense", done.dense_cloud), ("mesh", mesh)):
        if path.exists() and done.summary["stages"].get(name) is not None:
            print(f"{name:<9} {path}")


def _batch(parsed: argparse.Namespace, display: Display) -> None:
    cluster, parsed.cluster = parsed.cluster, None  # whole projects go there, and each runs where it comes to
    assignments = run_assignments(parsed)
    folder = BatchFolder.at(parsed.root)
    with ExitStack() as stack:
        workers = None
        if cluster:
            assignments.append("cluster.address=null")  # a worker must not wait for workers
            folder.make()
            options = ClusterOptions(address=cluster)
            workers = stack.enter_context(connected(options, folder.folder, [folder.root], display))
        done = batch(
            parsed.root,
            executor=workers,
            assignments=assignments,
            jobs=parsed.jobs,
            time_limit_s=parsed.time_limit,
            watch=parsed.watch,
            settle_s=parsed.settle,
            progress=display,
            command=shlex.join(["colmap-ihe", *parsed.arguments]),
        )
    if not _printed_as_json(parsed, display, done.as_dict()):
        print_batch(done)
        print(f"report    {folder.page_file}")
    if not done.succeeded:
        missing = sum(project.state != "done" for project in done.projects)
        raise KnownError(
            f"{missing} of {len(done.projects)} projects are not done", hint=f"{folder.page_file} says why"
        )


def _demo(parsed: argparse.Namespace, display: Display) -> None:
    done = demo(parsed.folder, parsed.assignments, display)
    if not _printed_as_json(parsed, display, dict(done.summary)):
        _print_made(done, f"demo in {parsed.folder}")


def _fit(parsed: argparse.Namespace, display: Display) -> None:
    names = ("method", "guard", "step", "sample", "weighting", "recount")
    assignments = [f"fit.{name}={json.dumps(getattr(parsed, name))}" for name in names]
    options = load_options(None, assignments).fit
    fit = fit_files(
        parsed.images,
        options,
        output=parsed.output,
        histogram=parsed.histogram,
        weights=read_weights(parsed.weights) if parsed.weights else None,
        develop=development(parsed),
        calibration=parsed.calibration,
        strict=parsed.strict,
        progress=display,
    )
    tried = fit.tried.as_dict() if fit.tried else None
    if _printed_as_json(parsed, display, {**fit.grey.as_dict(), "tried": tried, "left_out": fit.left_out}):
        return
    for reason in fit.left_out.values():
        display.warn(f"left out: {reason}")
    values = {name: value for name, value in fit.grey.as_dict().items() if name != "curve"}
    if tried:
        values |= {"chosen": tried["chosen"], "measured": tried["in_words"]}
    words = [", ".join(map(str, v)) if isinstance(v, list) else str(v) for v in values.values()]
    print_table("", list(zip(values, words, strict=True)))


def _convert(parsed: argparse.Namespace, display: Display) -> None:
    weights, grey, left_out = convert_folder(
        parsed.images,
        parsed.out,
        colour=parsed.colour,
        fit=FitOptions(method=parsed.method),
        weights=read_weights(parsed.weights) if parsed.weights else None,
        options=ConvertOptions(tone=parsed.tone, wallis=parsed.wallis, format=parsed.format),
        develop=development(parsed),
        calibration=parsed.calibration,
        cameras=load_options(None, camera_assignments(parsed)).cameras,
        strict=parsed.strict,
        progress=display,
    )
    tried = tried_in(parsed.out, weights.encoding) if parsed.method == "auto" and not parsed.weights else None
    result = {**weights.as_dict(), "tried": tried, "grey": grey, "left_out": left_out}
    if not _printed_as_json(parsed, display, result):
        words = f": {weights_in_words(weights.triplet)}" if isinstance(weights, Weights) else ""
        print(f"{len(grey)} grey images in {parsed.out} ({weights.method}{words})")
        if tried:
            print(f"measured  {tried['chosen']}: {tried['in_words']}")


def _status(parsed: argparse.Namespace, display: Display) -> None:
    options = project_options(parsed.project, [*parsed.assignments, *camera_assignments(parsed)])
    states = status(parsed.project, options, parsed.images)
    if _printed_as_json(parsed, display, [asdict(state) for state in states]):
        return
    times = ["" if s.seconds is None else f"{s.seconds:.0f} s" for s in states]
    rows = [(s.name, s.state, time, s.why, s.takes) for s, time in zip(states, times, strict=True)]
    print_table("", rows, ("stage", "state", "time", "why", "will take"))


def _compare(parsed: argparse.Namespace, display: Display) -> None:
    assignments = [*parsed.assignments, *(["dense.enabled=false"] if parsed.no_dense else [])]
    results = compare(
        parsed.project,
        project_options(parsed.project, assignments),
        methods=[name.strip() for name in parsed.methods.split(",") if name.strip()],
        seeds=parsed.seeds,
        pairs=parsed.pairs,
        images=parsed.images,
        progress=display,
    )
    if _printed_as_json(parsed, display, [asdict(result) for result in results]):
        return
    for table in tables_of(results):
        print_table(table.title, [tuple(row) for row in table.rows], tuple(table.columns))
    for sentence in sentences(results):
        print(sentence)
    print(f"report    {parsed.project / 'compare' / 'index.html'}")


def _draw(parsed: argparse.Namespace, display: Display) -> None:
    only, asked = asked_view(parsed)
    drawn = draw(
        parsed.project, draw_assignments(parsed), parsed.images, only=only, asked=asked, progress=display
    )
    if _printed_as_json(parsed, display, drawn):
        return
    for name, about in drawn.items():
        scale = f"1:{about['scale']} on {', '.join(about['papers'])}" if about["metric"] else "not to scale"
        print(f"{name:<9} {parsed.project / 'drawings' / name} ({scale})")


def _targets(parsed: argparse.Namespace, display: Display) -> None:
    pages = write_sheet(parsed.sheet, parsed.size, parsed.count, parsed.dictionary, parsed.first)
    names = [target_name(number) for number in range(parsed.first, parsed.first + parsed.count)]
    result = {"sheet": str(parsed.sheet), "pages": pages, "targets": names, "size_mm": parsed.size}
    if not _printed_as_json(parsed, display, result):
        sheets = "1 sheet" if pages == 1 else f"{pages} sheets"
        which = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
        print(f"{which} on {sheets} of A4 in {parsed.sheet}; print at 100 % and measure both rulers")


def _report(parsed: argparse.Namespace, display: Display) -> None:
    page = report(parsed.project, parsed.assignments, parsed.images, display)
    if not _printed_as_json(parsed, display, {"page": str(page)}):
        print(page)


def _doctor(parsed: argparse.Namespace, display: Display) -> None:
    values = doctor(parsed.project, parsed.assignments, parsed.images)
    if not _printed_as_json(parsed, display, values):
        print_table("", [(name, str(value)) for name, value in values.items()])


def _completion(parsed: argparse.Namespace, display: Display) -> None:
    script = shtab.complete(parser_of(COMMANDS), parsed.shell)
    if not _printed_as_json(parsed, display, {"script": script}):
        print(script)


def _printed_as_json(parsed: argparse.Namespace, display: Display, values: Any) -> bool:
    """Print the result as JSON where that is asked for."""
    if parsed.json:
        display.screen.result(json.dumps(values, indent=2, ensure_ascii=False))
    return bool(parsed.json)


_FUNCTIONS = (
    _demo,
    _reconstruct,
    _batch,
    _fit,
    _convert,
    _develop,
    _status,
    _compare,
    _draw,
    _targets,
    _report,
    _doctor,
    _completion,
)
COMMANDS: dict[str, CommandFunction] = {function.__name__[1:]: function for function in _FUNCTIONS}
