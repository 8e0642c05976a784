"""Reconstruct one project, from its photographs to a textured mesh and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import logged_to
from colmap_ihe.errors import MappingError, OptionError
from colmap_ihe.machine import scratch
from colmap_ihe.machine.cluster.connect import workers_for
from colmap_ihe.machine.files import guard_folder, room_on_disk, write_json
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.machine.threads import limited
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.estimates import disk_warnings, needs_of, stage_parts
from colmap_ihe.pipeline.given_calibration import given_calibration, write_found_calibration
from colmap_ihe.pipeline.given_control import given_control
from colmap_ihe.pipeline.input_digests import digests_of
from colmap_ihe.pipeline.page import page_of, seconds_in
from colmap_ihe.pipeline.provenance import write_provenance
from colmap_ihe.pipeline.records import fingerprints, inputs_of, read_record, why_stale
from colmap_ihe.pipeline.repeat import RunRecord, differences_from, write_run_record
from colmap_ihe.pipeline.resource_needs import Known, PhotoSetSize
from colmap_ihe.pipeline.run_stages import run_stages, warn_of
from colmap_ihe.pipeline.stage import RunContext, Shortfall
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES
from colmap_ihe.pipeline.stages.fit import write_weights_file
from colmap_ihe.pipeline.summary import summarise
from colmap_ihe.pipeline.warnings.unused_files import unused_files
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


@dataclass(frozen=True)
class Reconstruction:
    """Hold what a run left: the project's folder, the summary of report/summary.json, the stages that ran, and the page
    if it is of this run or still true."""

    project: Project
    summary: Mapping[str, Any]
    stages_run: tuple[str, ...]
    page: Path | None = None

    @property
    def sparse_model(self) -> Path:
        """Return the folder of the largest model, for `pycolmap.Reconstruction`."""
        return self.project.metric if self.summary["metric"] else self.project.sparse / "0"

    @property
    def dense_cloud(self) -> Path:
        """Return the file of the dense cloud."""
        return self.project.dense / "fused.ply"

    @property
    def mesh(self) -> Path:
        """Return the file of the mesh with vertex colours; the textured one lies beside it."""
        return self.project.mesh

    @property
    def textured_mesh(self) -> Path | None:
        """Return the file of the mesh with its texture, None without one."""
        return self.project.mesh.with_suffix(".glb") if self.summary["mesh_texture"] else None


class EndedEarlyError(MappingError):
    """Report a run that ended before its last stage, since what it made is too poor to go on with; `done`: what it
    left, which is whole."""

    def __init__(self, shortfall: Shortfall, done: Reconstruction) -> None:
        super().__init__(shortfall.reason, shortfall.hint)
        self.done = done


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
    then say how far it came, and the same call goes on from there. One of them, `EndedEarlyError`, comes after summary
    and page are written, where too few photographs are registered. `noted`: the record of another run, of which this
    one is a repetition; differences are told. `developed`: a folder where RAW photographs are kept developed, for
    other runs on them.
    """
    options = options or Options()
    _check_range(start, until, options)
    folder = Project.at(Path(project), Path(images) if images else None)
    discovery = find_photographs(folder.images)
    for stage in STAGES:
        stage.check(options, len(discovery.captures))
    given_calibration(folder, options)  # one that cannot be used is refused before any work
    given_control(folder, options)
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
        forced = STAGE_NAMES[STAGE_NAMES.index(start) :] if start else ()
        run = RunContext(
            folder, options, discovery, workers, until or STAGE_NAMES[-1], forced, developed=developed
        )
        given = _read_content(run, noted, progress)
        ran = _run(run, progress)
        _add_records(run)
        summary = summarise(run.records, options)
        _write_for_other_campaigns(run, ran)
        write_provenance(folder, given, run.records)
        page = _write_summary_and_page(run, summary, bool(ran), progress)
        outputs.remove_unfinished(folder)  # of workers that were killed, and whose tasks others did
    done = Reconstruction(folder, summary, ran, page)
    if run.shortfall is not None:
        raise EndedEarlyError(run.shortfall, done)
    return done


def _read_content(run: RunContext, noted: RunRecord | None, progress: RunProgress) -> dict[str, Any]:
    """Read what the run works on: its digests, by which stages are told to be up to date, and what is not used. Returns
    what records/run.json holds."""
    folder, options = run.project, run.options
    with progress.stage("content") as stage_progress:
        run.digests = digests_of(folder, run.discovery, run.executor, stage_progress)
        write_json(folder.digests_file, run.digests)
        given = write_run_record(folder, options, run.digests)
    warn_of(unused_files(folder), progress)
    warn_of(differences_from(noted, folder, options, run.digests) if noted else (), progress)
    run.inputs = inputs_of(folder, options, run.discovery, run.digests)
    run.prints = fingerprints(options, run.inputs)
    return given


def _write_for_other_campaigns(run: RunContext, ran: Sequence[str]) -> None:
    """Write report/weights.yaml and report/calibration.yaml, as far as the run came."""
    if "fit" in run.records:
        write_weights_file(run)
    if "sparse" in run.records and (
        {"sparse", "survey"} & {*ran} or not run.project.calibration_file.exists()
    ):
        write_found_calibration(run.project, run.model_folder, run.records["sparse"])


def _write_summary_and_page(
    run: RunContext, summary: dict[str, Any], anew: bool, progress: RunProgress
) -> Path | None:
    """Write report/summary.json, and the page if there is a model and the page is not of it; return the page of the
    model, None without one."""
    file, page = run.project.summary_file, run.project.page_file
    if not anew and page.exists():
        summary["page_seconds"] = seconds_in(file)
    write_json(file, summary)
    if "sparse" not in run.records:
        return None
    if anew or not page.exists():
        seconds = page_of(run, summary, progress)
        if seconds is None:
            return None
        summary["page_seconds"] = seconds
        write_json(file, summary)
    return page


def _run(run: RunContext, progress: RunProgress) -> tuple[str, ...]:
    """Run the stages that are due; tell the remaining time, and check memory and disk once the set is known."""

    def stage_done(name: str) -> None:
        parts = stage_parts(run.options, Known.from_records(run.records), run.until)
        progress.expect([part for part in parts if part.stage not in run.records])
        if name == "captures":
            size = PhotoSetSize.of(run.records[name], run.captures())
            run.needs = {needs.stage: needs for needs in needs_of(run.options, size)}
            warn_of(disk_warnings(run.project, list(run.needs.values()), _due(run)), progress)

    return run_stages(run, progress, stage_done)


def _add_records(run: RunContext) -> None:
    """Add the records of stages after those that were asked for, as far as they are up to date."""
    for stage in STAGES:
        if stage.name in run.records:
            continue
        record = None if stage.switched_off(run.options) else read_record(run.project, stage.name)
        if record is None or why_stale(run.project, stage, record, run.prints):
            return
        run.records[stage.name] = record


def _due(run: RunContext) -> tuple[str, ...]:
    """Return the names of the stages after `captures` that will run, and of the page after them."""
    names = STAGE_NAMES[1 : STAGE_NAMES.index(run.until) + 1]
    for number, stage in enumerate(STAGES[1 : len(names) + 1]):
        if stage.switched_off(run.options):
            continue
        record = None if stage.name in run.forced else read_record(run.project, stage.name)
        if record is None or why_stale(run.project, stage, record, run.prints):
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
