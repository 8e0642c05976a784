"""Skip, resume, run and cancel stages: what is up to date is kept, the rest is run and its record written last."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine import memory
from colmap_ihe.machine.files import require_same_folder
from colmap_ihe.machine.progress import RunProgress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.estimates import memory_warnings
from colmap_ihe.pipeline.input_digests import require_unchanged
from colmap_ihe.pipeline.records import read_record, versions_of, why_stale
from colmap_ihe.pipeline.stage import Record, RunContext, Stage
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES


def run_stages(run: RunContext, progress: RunProgress, stage_done: Callable[[str], None]) -> tuple[str, ...]:
    """Run the stages that are not up to date, in their order, and return the names of those that ran.

    Records of stages after `run.until` are removed where one before them runs. `stage_done` is called with the name of
    each stage whose record is in `run`. After a stage whose result is too poor for the next ones none runs, and
    `run.shortfall` says why. Raises `KnownError`s and `Cancelled`; the records then say how far it came.
    """
    ran = []
    for number, stage in enumerate(STAGES[: STAGE_NAMES.index(run.until) + 1]):
        if stage.switched_off(run.options):
            continue
        record = None if stage.name in run.forced else read_record(run.project, stage.name)
        if record is not None and not why_stale(run.project, stage, record, run.prints):
            if run.strict and record.get("left_out"):
                raise PhotographError(next(iter(record["left_out"].values())))
            progress.kept(stage.name)
        else:
            if needs := run.needs.get(stage.name):
                warn_of(memory_warnings(needs), progress)
            record = _run_stage(stage, STAGES[number + 1 :], run, progress)
            ran.append(stage.name)
        run.records[stage.name] = record
        stage_done(stage.name)
        run.shortfall = stage.shortfall(run.options, record)
        if run.shortfall is not None:
            break
    return tuple(ran)


def warn_of(warnings: Sequence[str], progress: RunProgress) -> None:
    """Show each of the warnings."""
    for text in warnings:
        progress.warn(text)


def _run_stage(stage: Stage, later: Sequence[Stage], run: RunContext, progress: RunProgress) -> Record:
    """Run one stage and write its record last; those of `later` stages are no longer true, and go first."""
    project, fingerprint = run.project, run.prints[stage.name]
    require_same_folder(project.root)
    for each in (stage, *later):
        _set_aside(each, run, progress)
    for each in later:
        project.drop_record(each.name)
    project.summary_file.unlink(missing_ok=True)
    if {"sparse", "survey"} & {stage.name, *(each.name for each in later)}:
        project.calibration_file.unlink(missing_ok=True)
    run.resumed = stage.name not in run.forced and project.was_begun(stage.name, fingerprint)
    if not run.resumed:
        project.drop_record(stage.name)
        outputs.remove(stage, project)
        project.begin(stage.name, fingerprint)
    began = time.monotonic()
    with progress.stage(stage.name) as stage_progress, memory.said_when_short(stage.name):
        result = stage.run(run, stage_progress).model_dump(exclude_unset=True)
        require_unchanged(run.discovery, run.digests, result.get("left_out", {}))
    record = {
        "stage": stage.name,
        "fingerprint": fingerprint,
        "options": stage.options_of(run.options),
        "versions": versions_of(stage),
        "inputs": run.inputs.get(stage.name, {}),
        "seed": run.options.sparse.seed,
        "threads": local_workers(),
        "seconds": round(time.monotonic() - began, 2),
        "resumed": run.resumed,
        "peak_memory_bytes": memory.most_taken(),
        **result,
    }
    record["made"] = outputs.states_of(stage, project, record)
    require_same_folder(project.root)
    project.write_record(stage.name, record)
    warn_of(record.get("warnings", []), progress)
    for name, reason in record.get("left_out", {}).items():
        progress.warn(f"left out: {reason if name in reason else f'{name}: {reason}'}")
    return record


def _set_aside(stage: Stage, run: RunContext, progress: RunProgress) -> None:
    """Keep what somebody has changed of what a stage left, since it will be written anew."""
    record = read_record(run.project, stage.name)
    for file in [] if record is None else outputs.set_aside(stage, run.project, record):
        kept = file.relative_to(run.project.root)
        progress.warn(
            f"{file.name} was changed since it was written and is made anew; yours is kept as {kept}"
        )
