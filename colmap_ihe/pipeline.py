"""The road from photographs to a coloured mesh: which stages there are, and how one is skipped,
resumed, run and cancelled.

A stage is up to date if its record carries the fingerprint that it would have now: of the options that
affect its result, of the versions of what computes it, and of the stage before it. The first link of that
chain is the content of the photographs. Never is anything skipped because a file is there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from colmap_ihe import outputs, preflight, stages
from colmap_ihe.again import Noted, note_run, unlike
from colmap_ihe.captures.discover import Discovery, discover
from colmap_ihe.cluster.connect import workers_for
from colmap_ihe.colmap import textured
from colmap_ihe.colmap.dense import pick_backend
from colmap_ihe.colmap.native import logged_to
from colmap_ihe.digests import FRAMES, content_of, digests_of
from colmap_ihe.errors import OptionError, PhotographError
from colmap_ihe.executor import local_executor
from colmap_ihe.expected import expected
from colmap_ihe.files import digest_file, fingerprint_of, room_on_disk, write_json
from colmap_ihe.options import Options
from colmap_ihe.pages import page_of
from colmap_ihe.progress import SILENT, Audience, Watch
from colmap_ihe.project import Project
from colmap_ihe.report.summary import summarise
from colmap_ihe.run import Record, Run
from colmap_ihe.version import __version__, library_versions


@dataclass(frozen=True)
class Stage:
    """One stop on the road. `options` names the sections, `libraries` the modules, that affect its result."""

    name: str
    run: Callable[[Run, Watch], Record]
    options: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()


ROAD = (
    Stage("captures", stages.captures, ("develop", "cameras"), ("rawpy", "libraw")),
    Stage("fit", stages.fit, ("fit",), ("rawpy", "libraw")),
    Stage("convert", stages.convert, ("convert",)),
    Stage("features", stages.features, ("camera", "features"), ("pycolmap",)),
    Stage("matches", stages.matches, ("matches",)),
    Stage("sparse", stages.sparse, ("sparse",)),
    Stage("dense", stages.dense, ("dense",), ("opencv",)),
    Stage("mesh", stages.mesh, ("mesh",)),
)
NAMES = tuple(stage.name for stage in ROAD)
_INPUT_CHANGED = "what it reads changed"


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


@dataclass(frozen=True)
class StageState:
    """Where one stage stands: "done", "stale" (and why), or "to do"."""

    name: str
    state: str
    why: str
    seconds: float | None


def reconstruct(
    project: str | Path,
    options: Options | None = None,
    *,
    images: str | Path | None = None,
    start: str | None = None,
    until: str | None = None,
    audience: Audience = SILENT,
    executor: Executor | None = None,
    noted: Noted | None = None,
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
        stack.enter_context(place.locked())
        stack.enter_context(logged_to(place.native_log))
        workers = executor or stack.enter_context(
            workers_for(options.cluster, place, [discovery.captures[0].path], audience)
        )
        run = Run(place, options, discovery, workers, developed=developed)
        with audience.stage("content") as watch:
            digests = digests_of(place, run.discovery, workers, watch)
            write_json(place.digests_file, digests)
            note_run(place, options, digests)
        for text in unlike(noted, digests) if noted else ():
            audience.warn(text)
        prints = _fingerprints(place, options, run.discovery, digests)
        ran = []
        last = NAMES.index(until) if until else len(ROAD) - 1
        for number, stage in enumerate(ROAD[: last + 1]):
            if switched_off(stage.name, options):
                continue
            forced = start is not None and number >= NAMES.index(start)
            record = None if forced else place.read_record(stage.name)
            if record is not None and not _why_stale(place, stage, record, prints):
                if options.captures.strict and record.get("left_out"):
                    raise PhotographError(next(iter(record["left_out"].values())))
                audience.kept(stage.name)
            else:
                record = _run_stage(stage, run, prints[stage.name], forced, audience)
                ran.append(stage.name)
            run.records[stage.name] = record
            if stage.name == "captures":
                counts = (record["images"], record["pixels"], record["with_gps"])
                audience.foresee(expected(options, *counts, NAMES[last]))
        for stage in ROAD[last + 1 :]:  # not asked for, but still true
            record = None if switched_off(stage.name, options) else place.read_record(stage.name)
            if record is None or _why_stale(place, stage, record, prints):
                break
            run.records[stage.name] = record
        summary = summarise(run.records, options)
        if "fit" in run.records:
            stages.write_weights(run)
        write_json(place.summary_file, summary)
        if "sparse" in run.records and (ran or not place.page_file.exists()):
            page_of(run, summary, audience)
    return Reconstruction(place, summary, tuple(ran))


def _check_range(start: str | None, until: str | None, options: Options) -> None:
    for name in (start, until):
        if name is not None and name not in NAMES:
            raise OptionError(f"no stage is called {name!r}", hint=f"the stages are {', '.join(NAMES)}")
    if start is not None and until is not None and NAMES.index(start) > NAMES.index(until):
        raise OptionError(f"--from {start} comes after --until {until}", hint="name an earlier --from")
    if start is not None and (switch := switched_off(start, options)):
        raise OptionError(f"--from {start}, and {switch} is switched off", hint=f"leave out --no-{switch}")


def switched_off(stage: str, options: Options) -> str:
    """The section whose `enabled` switches the stage off, empty if none does."""
    switches = {"dense": ("dense",), "mesh": ("dense", "mesh")}.get(stage, ())
    return next((name for name in switches if not getattr(options, name).enabled), "")


def status(
    project: str | Path, options: Options | None = None, images: str | Path | None = None
) -> list[StageState]:
    """Where each stage of a project stands, without changing anything. Raises `ProjectError`."""
    options = options or Options()
    place = Project.at(Path(project), Path(images) if images else None)
    discovery = discover(place.images)
    with local_executor() as threads:
        prints = _fingerprints(place, options, discovery, digests_of(place, discovery, threads, SILENT))
    states: list[StageState] = []
    stale_before = ""
    for stage in ROAD:
        record = place.read_record(stage.name)
        if switch := switched_off(stage.name, options):
            states.append(StageState(stage.name, "off", f"{switch}.enabled is false", None))
        elif record is None:
            why = "begun, not finished" if place.begun_file(stage.name).exists() else ""
            states.append(StageState(stage.name, "to do", why, None))
        elif why := _why_stale(place, stage, record, prints):
            if why == _INPUT_CHANGED:
                why = _what_changed(record, stage, options, stale_before)
            states.append(StageState(stage.name, "stale", why, record["seconds"]))
        else:
            states.append(StageState(stage.name, "done", "", record["seconds"]))
        if states[-1].state in ("stale", "to do") and not stale_before:
            stale_before = stage.name
    return states


def _why_stale(project: Project, stage: Stage, record: Record, prints: Mapping[str, str]) -> str:
    """Why a record does not count, empty if it does."""
    if record.get("fingerprint") != prints[stage.name]:
        return _INPUT_CHANGED
    gone = outputs.missing(stage.name, project, record)
    return f"{gone[0].name} is gone" if gone else ""


def _what_changed(record: Record, stage: Stage, options: Options, before: str) -> str:
    if record["options"] != _options_of(options, stage):
        return "its options changed"
    if record["versions"] != _versions_of(stage):
        return "a library changed"
    return f"{before} comes before it" if before else "the photographs changed"


def _run_stage(stage: Stage, run: Run, fingerprint: str, forced: bool, audience: Audience) -> Record:
    """Runs one stage and writes its record last; those after it are no longer true, and go first."""
    project = run.project
    for later in NAMES[NAMES.index(stage.name) + 1 :]:
        project.drop_record(later)
    project.summary_file.unlink(missing_ok=True)
    run.resumed = not forced and project.was_begun(stage.name, fingerprint)
    if not run.resumed:
        project.drop_record(stage.name)
        outputs.remove(stage.name, project)
        project.begin(stage.name, fingerprint)
    began = time.monotonic()
    with audience.stage(stage.name) as watch:
        result = stage.run(run, watch)
    record = {
        "stage": stage.name,
        "fingerprint": fingerprint,
        "options": _options_of(run.options, stage),
        "versions": _versions_of(stage),
        "seed": run.options.sparse.seed,
        "seconds": round(time.monotonic() - began, 2),
        "resumed": run.resumed,
        **result,
    }
    project.write_record(stage.name, record)
    for text in record.get("warnings", []):
        audience.warn(text)
    for name, reason in record.get("left_out", {}).items():
        audience.warn(f"left out: {reason if name in reason else f'{name}: {reason}'}")
    return record


def _options_of(options: Options, stage: Stage) -> dict[str, Any]:
    chosen = {name: getattr(options, name).model_dump(mode="json") for name in stage.options}
    if stage.name == "fit":
        chosen["fit"]["weights"] = options.fit.weights is not None  # their content counts, not where they lie
    if stage.name == "fit" and options.fit.method == "auto":
        chosen["trial"] = asdict(stages.trial_of(options))
    if stage.name == "dense":
        del chosen["dense"]["enabled"]
        chosen["dense"]["backend"] = pick_backend(options.dense.backend) if options.dense.enabled else "none"
    if stage.name == "mesh":
        del chosen["mesh"]["enabled"]
        if options.mesh.texture == "auto":
            chosen["mesh"]["texture"] = textured.is_possible()
    return chosen


def _versions_of(stage: Stage) -> dict[str, str]:
    return {"colmap-ihe": __version__, **library_versions(*stage.libraries)}


def _fingerprints(
    project: Project, options: Options, discovery: Discovery, digests: Mapping[str, list[Any]]
) -> dict[str, str]:
    """What the record of each stage would have to carry to be true now."""
    shots = [[c.name, digests[c.name][-1], list(c.paired), c.grey_stem] for c in discovery.captures]
    before = fingerprint_of(shots)
    prints: dict[str, str] = {}
    for stage in ROAD:
        chosen = _options_of(options, stage)
        besides = content_of(project.masks) if stage.name == "features" else []
        if stage.name == "fit" and options.fit.weights is not None:
            besides = _content_of_weights(project.root / options.fit.weights)
        if stage.name == "captures":
            besides = [[name, found[-1]] for name, found in digests.items() if name.startswith(FRAMES)]
        before = fingerprint_of(stage.name, chosen, _versions_of(stage), besides, before)
        prints[stage.name] = before
    return prints


def _content_of_weights(file: Path) -> list[list[str]]:
    try:
        return [["weights", digest_file(file)]]
    except OSError:  # the stage says so
        return [["weights", ""]]
