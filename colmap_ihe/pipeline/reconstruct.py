"""Down the road from photographs to a coloured mesh: how a stage is skipped, resumed, run and cancelled."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import logged_to
from colmap_ihe.errors import OptionError, PhotographError
from colmap_ihe.machine import memory, scratch
from colmap_ihe.machine.cluster.connect import workers_for
from colmap_ihe.machine.files import guard_folder, require_same_folder, room_on_disk, write_json
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.machine.threads import limited, local_workers
from colmap_ihe.photographs.discover import discover
from colmap_ihe.pipeline import outputs, preflight, stages
from colmap_ihe.pipeline import resource_check as foreseen
from colmap_ihe.pipeline.input_digests import digests_of, require_unchanged
from colmap_ihe.pipeline.page import page_of
from colmap_ihe.pipeline.repeat import RunRecord, differences_from, write_run_record
from colmap_ihe.pipeline.resource_needs import PhotoSetSize, needs_of
from colmap_ihe.pipeline.run_context import Record, RunContext
from colmap_ihe.pipeline.stage_list import (
    STAGE_NAMES,
    STAGES,
    Stage,
    fingerprints,
    inputs_of,
    options_of_stage,
    switched_off,
    versions_of,
    why_stale,
)
from colmap_ihe.pipeline.time_estimate import Known, stage_parts
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.report.summary import summarise


@dataclass(frozen=True)
class Reconstruction:
    """What a run left: the project's folder, the summary of report/summary.json, and what was kept."""

    project: Project
    summary: Mapping[str, Any]
    stages_run: tuple[str, ...]

    @property
    def sparse_model(self) -> Path:
        """The folder of the largest model, for `pycolmap.Reconstruction`."""
        return self.project.sparse / "0"

    @property
    def dense_cloud(self) -> Path:
        return self.project.dense / "fused.ply"

    @property
    def mesh(self) -> Path:
        return self.project.mesh


def reconstruct(
    project: str | Path,
    options: Options | None = None,
    *,
    images: str | Path | None = None,
    start: str | None = None,
    until: str | None = None,
    progress: RunProgress = SILENT,
    executor: Executor | None = None,
    noted: RunRecord | None = None,
    developed: Path | None = None,
) -> Reconstruction:
    """Photographs in `project/images` to a model in `project/workspace`, going on from what is up to date.

    `start` runs that stage and all after it again; `until` ends after a stage. `executor`: of any kind, for
    per-image work, instead of what `options.cluster` says. Raises `KnownError`s, and `Cancelled`; the records
    then say how far it came, and the same call goes on from there. `noted`: what another run noted, of which this
    one is a repetition; what is unlike is told. `developed`: a folder where RAW photographs are kept developed, for
    other runs on them.
    """
    options = options or Options()
    _check_range(start, until, options)
    place = Project.at(Path(project), Path(images) if images else None)
    discovery = discover(place.images)
    preflight.check_options(options, len(discovery.captures))
    with ExitStack() as stack:
        stack.enter_context(room_on_disk(place.root))
        place.claim()
        stack.enter_context(limited(options.machine.threads))
        stack.enter_context(place.locked())
        stack.enter_context(guard_folder(place.root))
        scratch.sweep()
        outputs.remove_unfinished(place)
        stack.enter_context(logged_to(place.native_log))
        workers = executor or stack.enter_context(
            workers_for(options.cluster, place, [discovery.captures[0].path], progress)
        )
        run = RunContext(place, options, discovery, workers, developed=developed)
        with progress.stage("content") as stage_progress:
            run.digests = digests = digests_of(place, run.discovery, workers, stage_progress)
            write_json(place.digests_file, digests)
            write_run_record(place, options, digests)
        for text in differences_from(noted, place, options, digests) if noted else ():
            progress.warn(text)
        run.inputs = inputs_of(place, options, run.discovery, digests)
        prints = fingerprints(options, run.inputs)
        last = STAGE_NAMES.index(until) if until else len(STAGES) - 1
        ran = _up_to(last, run, prints, start, progress)
        for stage in STAGES[last + 1 :]:  # not asked for, but still true
            record = None if switched_off(stage.name, options) else place.read_record(stage.name)
            if record is None or why_stale(place, stage, record, prints):
                break
            run.records[stage.name] = record
        summary = summarise(run.records, options)
        if "fit" in run.records:
            stages.write_weights(run)
        write_json(place.summary_file, summary)
        if "sparse" in run.records and (ran or not place.page_file.exists()):
            page_of(run, summary, progress)
        outputs.remove_unfinished(place)  # of workers that were killed, and whose tasks others did
    return Reconstruction(place, summary, ran)


def _up_to(
    last: int, run: RunContext, prints: Mapping[str, str], start: str | None, progress: RunProgress
) -> tuple[str, ...]:
    """Runs what is not up to date, as far as the stage of that number, and returns the names of what ran."""
    place, options = run.project, run.options
    ran = []
    for number, stage in enumerate(STAGES[: last + 1]):
        if switched_off(stage.name, options):
            continue
        forced = start is not None and number >= STAGE_NAMES.index(start)
        record = None if forced else place.read_record(stage.name)
        if record is not None and not why_stale(place, stage, record, prints):
            if options.captures.strict and record.get("left_out"):
                raise PhotographError(next(iter(record["left_out"].values())))
            progress.kept(stage.name)
        else:
            if demand := run.demands.get(stage.name):
                _tell(progress, foreseen.memory_warnings(demand))
            record = _run_stage(stage, run, prints[stage.name], forced, progress)
            ran.append(stage.name)
        run.records[stage.name] = record
        parts = stage_parts(options, Known.from_records(run.records), STAGE_NAMES[last])
        progress.expect([part for part in parts if part.stage not in run.records])
        if stage.name == "captures":
            run.demands = {
                one.stage: one for one in needs_of(options, PhotoSetSize.of(record, run.captures()))
            }
            due = _due(place, options, prints, start, last)
            _tell(progress, foreseen.disk_warnings(place, list(run.demands.values()), due))
    return tuple(ran)


def _due(
    place: Project, options: Options, prints: Mapping[str, str], start: str | None, last: int
) -> tuple[str, ...]:
    """The names of the stages after `captures` that will run, and of the page after them."""
    for number, stage in enumerate(STAGES[1 : last + 1], 1):
        if switched_off(stage.name, options):
            continue
        record = place.read_record(stage.name)
        forced = start is not None and number >= STAGE_NAMES.index(start)
        if forced or record is None or why_stale(place, stage, record, prints):
            return (
                *STAGE_NAMES[number : last + 1],
                *(["page"] if last >= STAGE_NAMES.index("sparse") else []),
            )
    return ()


def _tell(progress: RunProgress, warnings: Iterable[str]) -> None:
    for text in warnings:
        progress.warn(text)


def _check_range(start: str | None, until: str | None, options: Options) -> None:
    for name in (start, until):
        if name is not None and name not in STAGE_NAMES:
            raise OptionError(f"no stage is called {name!r}", hint=f"the stages are {', '.join(STAGE_NAMES)}")
    if start is not None and until is not None and STAGE_NAMES.index(start) > STAGE_NAMES.index(until):
        raise OptionError(f"--from {start} comes after --until {until}", hint="name an earlier --from")
    if start is not None and (switch := switched_off(start, options)):
        raise OptionError(f"--from {start}, and {switch} is switched off", hint=f"leave out --no-{switch}")


def _run_stage(
    stage: Stage, run: RunContext, fingerprint: str, forced: bool, progress: RunProgress
) -> Record:
    """Runs one stage and writes its record last; those after it are no longer true, and go first."""
    project = run.project
    require_same_folder(project.root)
    _set_aside(stage, run, progress)
    for later in STAGE_NAMES[STAGE_NAMES.index(stage.name) + 1 :]:
        project.drop_record(later)
    project.summary_file.unlink(missing_ok=True)
    run.resumed = not forced and project.was_begun(stage.name, fingerprint)
    if not run.resumed:
        project.drop_record(stage.name)
        outputs.remove(stage.name, project)
        project.begin(stage.name, fingerprint)
    began = time.monotonic()
    with progress.stage(stage.name) as stage_progress, memory.said_when_short(stage.name):
        result = stage.run(run, stage_progress)
        require_unchanged(run.discovery, run.digests, result.get("left_out", {}))
    record = {
        "stage": stage.name,
        "fingerprint": fingerprint,
        "options": options_of_stage(run.options, stage),
        "versions": versions_of(stage),
        "inputs": run.inputs.get(stage.name, {}),
        "seed": run.options.sparse.seed,
        "threads": local_workers(),
        "seconds": round(time.monotonic() - began, 2),
        "resumed": run.resumed,
        **result,
    }
    record["made"] = outputs.made_by(stage.name, project, record)
    require_same_folder(project.root)
    project.write_record(stage.name, record)
    _tell(progress, record.get("warnings", []))
    for name, reason in record.get("left_out", {}).items():
        progress.warn(f"left out: {reason if name in reason else f'{name}: {reason}'}")
    return record


def _set_aside(stage: Stage, run: RunContext, progress: RunProgress) -> None:
    """What somebody has changed of what this stage and those after it left is kept: they write it anew."""
    for name in STAGE_NAMES[STAGE_NAMES.index(stage.name) :]:
        record = run.project.read_record(name)
        if record is None:
            continue
        for file in outputs.set_aside(name, run.project, record):
            where = file.relative_to(run.project.root)
            progress.warn(
                f"{file.name} was changed since it was written and is made anew; yours is kept as {where}"
            )
