"""What each command runs, and what it prints: plain words, tables, or JSON."""

from __future__ import annotations

import argparse
import json
import shlex
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

from colmap_ihe.batch.driver import batch
from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.commandline.arguments import CommandFunction
from colmap_ihe.commandline.bars import print_summary, print_table
from colmap_ihe.commandline.batch_display import batch_audience, print_batch
from colmap_ihe.commandline.display import Display, printable
from colmap_ihe.commandline.shared_arguments import camera_assignments, development, road_assignments
from colmap_ihe.errors import KnownError
from colmap_ihe.evaluation.compare import compare
from colmap_ihe.evaluation.demo.run import demo
from colmap_ihe.evaluation.tables import sentences, tables_of
from colmap_ihe.fit.weights_file import read_weights
from colmap_ihe.grey.weights import Weights
from colmap_ihe.machine.cluster.connect import connected
from colmap_ihe.pipeline.convert_folder import convert_folder
from colmap_ihe.pipeline.develop_folder import develop_folder
from colmap_ihe.pipeline.doctor import doctor
from colmap_ihe.pipeline.fit_files import fit_files
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.pipeline.repeat import read_run
from colmap_ihe.pipeline.rewrite_page import report
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.options import ClusterOptions, ConvertOptions, FitOptions
from colmap_ihe.project.options_file import load_options, project_options
from colmap_ihe.report.summary import weights_in_words


def _develop(parsed: argparse.Namespace, follower: Display) -> None:
    names, steps, left_out = develop_folder(
        parsed.images,
        parsed.out,
        options=development(parsed),
        calibration=parsed.calibration,
        strict=parsed.strict,
        progress=follower,
    )
    if parsed.json:
        _result(follower, {"linear": names, "steps": steps, "left_out": left_out})
        return
    print(f"{len(names)} linear TIFFs in {parsed.out}")
    for camera, done in steps.items():
        print(printable(f"{camera}: {', '.join(done)}"))


def _reconstruct(parsed: argparse.Namespace, follower: Display) -> None:
    assignments = road_assignments(parsed)
    if parsed.weights:
        assignments.append(f"fit.weights={json.dumps(str(parsed.weights.absolute()))}")
    noted = read_run(parsed.from_record, assignments) if parsed.from_record else None
    done = reconstruct(
        parsed.project,
        noted.options if noted else project_options(parsed.project, assignments),
        images=parsed.images,
        start=parsed.start,
        until=parsed.until,
        progress=follower,
        noted=noted,
    )
    if parsed.json:
        _result(follower, dict(done.summary))
        return
    print_summary(done.summary, title=str(parsed.project))
    _print_report(done)
    for name, place in (("sparse", done.sparse_model), ("dense", done.dense_cloud), ("mesh", done.mesh)):
        if place.exists() and done.summary["stages"].get(name) is not None:
            print(f"{name:<9} {place}")


def _batch(parsed: argparse.Namespace, follower: Display) -> None:
    cluster, parsed.cluster = parsed.cluster, None  # whole projects go there, and each runs where it comes to
    folder = BatchFolder.at(parsed.root)
    with ExitStack() as stack:
        workers, alone = None, []
        if cluster:
            alone = ["cluster.address=null"]  # a worker must not wait for workers, whatever project.yaml says
            folder.make()
            where = ClusterOptions(address=cluster)
            workers = stack.enter_context(connected(where, folder.folder, [folder.root], follower))
        progress = stack.enter_context(batch_audience(follower))
        done = batch(
            parsed.root,
            executor=workers,
            assignments=[*road_assignments(parsed), *alone],
            jobs=parsed.jobs,
            time_limit_s=parsed.time_limit,
            watch=parsed.watch,
            settle_s=parsed.settle,
            progress=progress,
            command=shlex.join(["colmap-ihe", *parsed.arguments]),
        )
    page = folder.page_file
    if parsed.json:
        _result(follower, done.as_dict())
    else:
        print_batch(done)
        print(f"report    {page}")
    if not done.succeeded:
        missing = sum(project.state != "done" for project in done.projects)
        raise KnownError(f"{missing} of {len(done.projects)} projects are not done", hint=f"{page} says why")


def _print_report(done: Reconstruction) -> None:
    """The page, or where the run ended before it the summary."""
    page = done.project.page_file
    print(f"report    {page if page.exists() else done.project.summary_file}")


def _demo(parsed: argparse.Namespace, follower: Display) -> None:
    done = demo(parsed.folder, parsed.assignments, follower)
    if parsed.json:
        _result(follower, dict(done.summary))
    else:
        print_summary(done.summary, title=f"demo in {parsed.folder}")
        _print_report(done)
        print(f"dense     {done.dense_cloud}")


def _fit(parsed: argparse.Namespace, follower: Display) -> None:
    names = ("method", "guard", "step", "sample", "weighting", "recount")
    assignments = [f"fit.{name}={json.dumps(getattr(parsed, name))}" for name in names]
    options = load_options(None, assignments).fit
    weights, left_out = fit_files(
        parsed.images,
        options,
        output=parsed.output,
        histogram=parsed.histogram,
        weights=read_weights(parsed.weights) if parsed.weights else None,
        develop=development(parsed),
        calibration=parsed.calibration,
        strict=parsed.strict,
        progress=follower,
    )
    result = {**weights.as_dict(), "left_out": left_out}
    if parsed.json:
        _result(follower, result)
        return
    for reason in left_out.values():
        follower.warn(f"left out: {reason}")
    print_table(
        "",
        [
            (name, ", ".join(map(str, v)) if isinstance(v, list) else str(v))
            for name, v in weights.as_dict().items()
            if name != "curve"
        ],
    )


def _convert(parsed: argparse.Namespace, follower: Display) -> None:
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
        progress=follower,
    )
    if parsed.json:
        _result(follower, {**weights.as_dict(), "grey": grey, "left_out": left_out})
    else:
        words = f": {weights_in_words(weights.triplet)}" if isinstance(weights, Weights) else ""
        print(f"{len(grey)} grey images in {parsed.out} ({weights.method}{words})")


def _status(parsed: argparse.Namespace, follower: Display) -> None:
    options = project_options(parsed.project, [*parsed.assignments, *camera_assignments(parsed)])
    states = status(parsed.project, options, parsed.images)
    if parsed.json:
        _result(follower, [asdict(state) for state in states])
        return
    rows = [
        (s.name, s.state, "" if s.seconds is None else f"{s.seconds:.0f} s", s.why, s.takes) for s in states
    ]
    print_table("", rows, ("stage", "state", "time", "why", "will take"))


def _compare(parsed: argparse.Namespace, follower: Display) -> None:
    assignments = [*parsed.assignments, *(["dense.enabled=false"] if parsed.no_dense else [])]
    results = compare(
        parsed.project,
        project_options(parsed.project, assignments),
        methods=[name.strip() for name in parsed.methods.split(",") if name.strip()],
        seeds=parsed.seeds,
        pairs=parsed.pairs,
        images=parsed.images,
        progress=follower,
    )
    if parsed.json:
        _result(follower, [asdict(result) for result in results])
        return
    for table in tables_of(results):
        print_table(table.title, [tuple(row) for row in table.rows], tuple(table.columns))
    for sentence in sentences(results):
        print(sentence)
    print(f"report    {parsed.project / 'compare' / 'index.html'}")


def _report(parsed: argparse.Namespace, follower: Display) -> None:
    page = report(parsed.project, parsed.assignments, parsed.images, follower)
    if parsed.json:
        _result(follower, {"page": str(page)})
    else:
        print(page)


def _doctor(parsed: argparse.Namespace, follower: Display) -> None:
    found = doctor(parsed.project, parsed.assignments, parsed.images)
    if parsed.json:
        _result(follower, found)
    else:
        print_table("", [(name, str(value)) for name, value in found.items()])


def _result(follower: Display, values: Any) -> None:
    follower.result(json.dumps(values, indent=2, ensure_ascii=False))


RUNS: dict[str, CommandFunction] = {
    "demo": _demo,
    "reconstruct": _reconstruct,
    "batch": _batch,
    "fit": _fit,
    "convert": _convert,
    "develop": _develop,
    "status": _status,
    "compare": _compare,
    "report": _report,
    "doctor": _doctor,
}
