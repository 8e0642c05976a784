"""Tell how far each stage of a project is, and why it would run again: which photograph, option or library changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.machine.words import listed
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.pipeline import records
from colmap_ihe.pipeline.estimates import in_words, needs_of
from colmap_ihe.pipeline.input_digests import digests_of
from colmap_ihe.pipeline.resource_needs import PhotoSetSize
from colmap_ihe.pipeline.stage import Inputs, Record, Stage
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_SHOWN = 3
_NOTHING = "the default"
_FOLLOWS = "names of grey images"  # from the names of photographs, where those say it


@dataclass(frozen=True)
class StageState:
    """Say how far a stage is: "done" (and why the run ends there, if it does), "stale" (and why), "to do" or "off".
    `takes`: the memory and disk that it needs, in words, where it is to run and the photographs were surveyed."""

    name: str
    state: str
    why: str
    seconds: float | None
    takes: str = ""


def status(
    project: str | Path, options: Options | None = None, images: str | Path | None = None
) -> list[StageState]:
    """Return the state of each stage of a project, without changing anything. Raises `ProjectError`."""
    options = options or Options()
    folder = Project.at(Path(project), Path(images) if images else None)
    discovery = find_photographs(folder.images)
    with local_executor() as threads:
        inputs = records.inputs_of(folder, options, discovery, digests_of(folder, discovery, threads, SILENT))
    prints = records.fingerprints(options, inputs)
    states: list[StageState] = []
    stale = ""  # the first stage that would run
    for stage in STAGES:
        record = records.read_record(folder, stage.name)
        seconds = None if record is None else record["seconds"]
        if switch := stage.switched_off(options):
            state = StageState(stage.name, "off", f"{switch}.enabled is false", None)
        elif record is None:
            why = "begun, not finished" if folder.begun_file(stage.name).exists() else ""
            state = StageState(stage.name, "to do", why, None)
        elif why := records.why_stale(folder, stage, record, prints):
            if why == records.INPUT_CHANGED:
                why = _what_changed(record, stage, options, inputs[stage.name], stale)
            state = StageState(stage.name, "stale", why, seconds)
        elif stale:
            state = StageState(stage.name, "stale", f"{stale} comes before it", seconds)
        else:
            shortfall = stage.shortfall(options, record)
            state = StageState(stage.name, "done", shortfall.reason if shortfall else "", seconds)
        states.append(state)
        if state.state in ("stale", "to do") and not stale:
            stale = stage.name
    return _with_needs(states, folder, options, discovery)


def _with_needs(
    states: list[StageState], project: Project, options: Options, discovery: Discovery
) -> list[StageState]:
    survey = records.read_record(project, "captures")
    if survey is None:
        return states
    captures = [replace(c, pixels=int(survey["largest"])) for c in discovery.captures]
    takes = {n.stage: in_words(n) for n in needs_of(options, PhotoSetSize.of(survey, captures))}
    return [replace(s, takes=takes.get(s.name, "")) if s.state in ("stale", "to do") else s for s in states]


def _what_changed(record: Record, stage: Stage, options: Options, inputs: Inputs, before: str) -> str:
    """Say how a stage's record differs from what it would run with. `before`: one before it that runs again, if any."""
    reasons = [
        *_of_inputs(record.get("inputs", {}), inputs),
        *_of_values("its options changed", _flat(record["options"]), _flat(stage.options_of(options))),
        *_of_values("a library changed", record["versions"], records.versions_of(stage)),
    ]
    if reasons:
        return "; ".join(reasons)
    return f"{before} comes before it" if before else "it was made by another version"


def _of_inputs(was: Inputs, now: Inputs) -> list[str]:
    reasons: list[str] = []
    for kind in [*now, *(k for k in was if k not in now)]:
        changes = _changes(was.get(kind, {}), now.get(kind, {}))
        if changes and not (kind == _FOLLOWS and reasons):
            reasons.append(f"the {kind} changed: {_first(changes)}")
    return reasons


def _changes(was: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    gone = [name for name in was if name not in now]
    new = [name for name in now if name not in was]
    changes = []
    for name in list(new):
        same = next((old for old in gone if was[old] == now[name] and was[old]), None)
        if same is not None:
            changes.append(f"{same} is now called {name}")
            gone.remove(same)
            new.remove(name)
    changes += [f"{name} is new" for name in new]
    changes += [f"{name} is gone" for name in gone]
    return changes + [f"{name} has another content" for name in now if name in was and was[name] != now[name]]


def _flat(values: Any, path: str = "") -> dict[str, Any]:
    """Return options by their names as in `--set`; an empty mapping is none at all."""
    if not isinstance(values, Mapping):
        return {path: values}
    return {
        k: v for name, value in values.items() for k, v in _flat(value, f"{path}.{name}".lstrip(".")).items()
    }


def _of_values(words: str, was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    changes = [
        f"{name} from {_shown(was, name)} to {_shown(now, name)}"
        for name in sorted({*was, *now})
        if was.get(name, None) != now.get(name, None) or (name in was) != (name in now)
    ]
    return [f"{words}: {_first(changes)}"] if changes else []


def _shown(values: Mapping[str, Any], name: str) -> str:
    if name not in values:
        return _NOTHING
    value = values[name]
    if value is None or isinstance(value, bool):
        return {None: "none", True: "true", False: "false"}[value]
    return str(value)


def _first(changes: list[str]) -> str:
    return listed(changes, _SHOWN)
