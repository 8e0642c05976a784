"""Where each stage of a project stands, and why it would run again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import Discovery, discover
from colmap_ihe.pipeline.explain import what_changed
from colmap_ihe.pipeline.input_digests import digests_of
from colmap_ihe.pipeline.resource_check import in_words
from colmap_ihe.pipeline.resource_needs import PhotoSetSize, needs_of
from colmap_ihe.pipeline.stage_list import (
    INPUT_CHANGED,
    STAGES,
    fingerprints,
    inputs_of,
    switched_off,
    why_stale,
)
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


@dataclass(frozen=True)
class StageState:
    """Where one stage stands: "done", "stale" (and why), or "to do". `takes`: memory and disk that it will take, in
    words, where it is to run and the photographs were looked at."""

    name: str
    state: str
    why: str
    seconds: float | None
    takes: str = ""


def status(
    project: str | Path, options: Options | None = None, images: str | Path | None = None
) -> list[StageState]:
    """Where each stage of a project stands, without changing anything. Raises `ProjectError`."""
    options = options or Options()
    place = Project.at(Path(project), Path(images) if images else None)
    discovery = discover(place.images)
    with local_executor() as threads:
        inputs = inputs_of(place, options, discovery, digests_of(place, discovery, threads, SILENT))
    prints = fingerprints(options, inputs)
    states: list[StageState] = []
    stale_before = ""
    for stage in STAGES:
        record = place.read_record(stage.name)
        if switch := switched_off(stage.name, options):
            states.append(StageState(stage.name, "off", f"{switch}.enabled is false", None))
        elif record is None:
            why = "begun, not finished" if place.begun_file(stage.name).exists() else ""
            states.append(StageState(stage.name, "to do", why, None))
        elif why := why_stale(place, stage, record, prints):
            if why == INPUT_CHANGED:
                why = what_changed(record, stage, options, inputs.get(stage.name, {}), stale_before)
            states.append(StageState(stage.name, "stale", why, record["seconds"]))
        elif stale_before:
            states.append(
                StageState(stage.name, "stale", f"{stale_before} comes before it", record["seconds"])
            )
        else:
            states.append(StageState(stage.name, "done", "", record["seconds"]))
        if states[-1].state in ("stale", "to do") and not stale_before:
            stale_before = stage.name
    return _with_demands(states, place, options, discovery)


def _with_demands(
    states: list[StageState], place: Project, options: Options, discovery: Discovery
) -> list[StageState]:
    first = place.read_record("captures")
    if first is None:
        return states
    captures = [replace(c, pixels=int(first["largest"])) for c in discovery.captures]
    takes = {one.stage: in_words(one) for one in needs_of(options, PhotoSetSize.of(first, captures))}
    return [replace(s, takes=takes.get(s.name, "")) if s.state in ("stale", "to do") else s for s in states]
