"""Reconstruct one project, from its photographs to a textured mesh and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import logged_to
from colmap_ihe.errors import OptionError
from colmap_ihe.machine import scratch
from colmap_ihe.machine.cluster.connect import workers_for
from colmap_ihe.machine.files import guard_folder, room_on_disk, write_json
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.machine.threads import limited
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.estimates import needs_of, stage_parts
from colmap_ihe.pipeline.fingerprints import fingerprints, inputs_of, why_stale
from colmap_ihe.pipeline.input_digests import digests_of
from colmap_ihe.pipeline.page import page_of
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.repeat import RunRecord, differences_from, write_run_record
from colmap_ihe.pipeline.resource_check import disk_warnings
from colmap_ihe.pipeline.resource_needs import PhotoSetSize
from colmap_ihe.pipeline.run_context import RunContext
from colmap_ihe.pipeline.run_stages import run_stages, warn_of
from colmap_ihe.pipeline.stage import Stage
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES
from colmap_ihe.pipeline.stages.fit import write_weights_file
from colmap_ihe.pipeline.time_estimate import Known
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.report.summary import summarise


@dataclass(frozen=True)
class Reconstruction:
    """Hold what a run left: the project's folder, the summary of report/summary.json, and the stages that ran."""

    project: Project
    summary: Mapping[str, Any]
    stages_run: tuple[str, ...]

    @property
    def sparse_model(self) -> Path:
        """Return the folder of the largest model, for `pycolmap.Reconstruction`."""
        return self.project.sparse / "0"

    @property
    def dense_cloud(self) -> Path:
        """Return the file of the dense cloud."""
        return self.project.dense / "fused.ply"

    @property
    def mesh(self) -> Path:
        """Return the file of the mesh with vertex colours; the textured one lies beside it."""
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
    """Make a model in `project/workspace` from the photographs in `project/images`; what is up to date is kept.

    `start` runs that stage and all after it again; `until` ends after a stage. `executor`: of any kind, for
    per-image work, instead of what `options.cluster` says. Raises `KnownError`s, and `Cancelled`; the records
    then say how far it came, and the same call goes on from there. `noted`: the record of another run, of which this
    one is a repetition; differences are told. `developed`: a folder where RAW photographs are kept developed, for
    other runs on them.
    """
    options = options or Options()
    _check_range(start, until, options)
    folder = Project.at(Path(project), Path(images) if images else None)
    discovery = find_photographs(folder.images)
    for stage in STAGES:
        stage.check(options, len(discovery.captures))
    with ExitStack() as stack:
        stack.enter_context(room_on_disk(folder.root))
        folder.claim()
        stack.enter_context(limited(options.machine.threads))
        stack.enter_context(folder.locked())
        stack.enter_context(guard_folder(folder.root))
        scratch.sweep()
        outputs.remove_unfinished(folder)
        stack.enter_context(logged_to(folder.native_log))
        workers = executor or stack.enter_context(
            workers_for(options.cluster, folder, [discovery.captures[0].path], progress)
        )
        run = RunContext(folder, options, discovery, workers, developed=developed)
        with progress.stage("content") as stage_progress:
            run.digests = digests_of(folder, discovery, workers, stage_progress)
            write_json(folder.digests_file, run.digests)
            write_run_record(folder, options, run.digests)
        warn_of(differences_from(noted, folder, options, run.digests) if noted else (), progress)
        run.inputs = inputs_of(folder, options, discovery, run.digests)
        prints = fingerprints(options, run.inputs)
        forced = STAGE_NAMES[STAGE_NAMES.index(start) :] if start else ()
        ran = _run(run, prints, until or STAGE_NAMES[-1], forced, progress)
        _add_records(run, prints)
        summary = summarise(run.records, options)
        if "fit" in run.records:
            write_weights_file(run)
        write_json(folder.summary_file, summary)
        if "sparse" in run.records and (ran or not folder.page_file.exists()):
            page_of(run, summary, progress)
        outputs.remove_unfinished(folder)  # of workers that were killed, and whose tasks others did
    return Reconstruction(folder, summary, ran)


def _run(
    run: RunContext,
    prints: Mapping[str, str],
    until: str,
    forced: Sequence[str],
    progress: RunProgress,
) -> tuple[str, ...]:
    """Run the stages up to `until` that are due; tell the remaining time, and check memory and disk once the set is
    known."""

    def stage_done(name: str) -> None:
        parts = stage_parts(run.options, Known.from_records(run.records), until)
        progress.expect([part for part in parts if part.stage not in run.records])
        if name == "captures":
            size = PhotoSetSize.of(run.records[name], run.captures())
            run.needs = {needs.stage: needs for needs in needs_of(run.options, size)}
            due = _due(STAGES[1 : STAGE_NAMES.index(until) + 1], run, prints, forced)
            warn_of(disk_warnings(run.project, list(run.needs.values()), due), progress)

    return run_stages(STAGES, run, prints, progress, until=until, forced=forced, stage_done=stage_done)


def _add_records(run: RunContext, prints: Mapping[str, str]) -> None:
    """Add the records of stages after those that were asked for, as far as they are up to date."""
    for stage in STAGES:
        if stage.name in run.records:
            continue
        record = None if stage.switched_off(run.options) else read_record(run.project, stage.name)
        if record is None or why_stale(run.project, stage, record, prints):
            return
        run.records[stage.name] = record


def _due(
    stages: Sequence[Stage], run: RunContext, prints: Mapping[str, str], forced: Sequence[str]
) -> tuple[str, ...]:
    """Return the names of the stages that will run, and of the page after them."""
    names = tuple(stage.name for stage in stages)
    for number, stage in enumerate(stages):
        if stage.switched_off(run.options):
            continue
        record = None if stage.name in forced else read_record(run.project, stage.name)
        if record is None or why_stale(run.project, stage, record, prints):
            return (*names[number:], *(["page"] if "sparse" in names else []))
    return ()


def _check_range(start: str | None, until: str | None, options: Options) -> None:
    for name in (start, until):
        if name is not None and name not in STAGE_NAMES:
            raise OptionError(f"no stage is called {name!r}", hint=f"the stages are {', '.join(STAGE_NAMES)}")
    if start is None:
        return
    if until is not None and STAGE_NAMES.index(start) > STAGE_NAMES.index(until):
        raise OptionError(f"--from {start} comes after --until {until}", hint="name an earlier --from")
    if switch := STAGES[STAGE_NAMES.index(start)].switched_off(options):
        raise OptionError(f"--from {start}, and {switch} is switched off", hint=f"leave out --no-{switch}")
