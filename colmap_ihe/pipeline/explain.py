"""Why a stage would run again, in words: which photograph, which option from what to what, which library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from colmap_ihe.pipeline.run_context import Record
from colmap_ihe.pipeline.stage_list import Inputs, Stage, options_of_stage, versions_of
from colmap_ihe.project.options import Options

_SHOWN = 3
_NOTHING = "the default"
_FOLLOWS = "names of grey images"  # from the names of photographs, where those say it


def what_changed(record: Record, stage: Stage, options: Options, inputs: Inputs, before: str) -> str:
    """Between the record of a stage and what it would run with now. `before`: the stage before it that runs again,
    empty if none does."""
    reasons = [
        *_of_inputs(record.get("inputs", {}), inputs),
        *_of_values("its options changed", _flat(record["options"]), _flat(options_of_stage(options, stage))),
        *_of_values("a library changed", record["versions"], versions_of(stage)),
    ]
    if reasons:
        return "; ".join(reasons)
    return f"{before} comes before it" if before else "it was made by another version"


def _of_inputs(was: Inputs, now: Inputs) -> list[str]:
    found: list[str] = []
    for kind in [*now, *(k for k in was if k not in now)]:
        changes = _changes(was.get(kind, {}), now.get(kind, {}))
        if changes and not (kind == _FOLLOWS and found):
            found.append(f"the {kind} changed: {_some(changes)}")
    return found


def _changes(was: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    gone = [name for name in was if name not in now]
    new = [name for name in now if name not in was]
    said = []
    for name in list(new):
        same = next((old for old in gone if was[old] == now[name] and was[old]), None)
        if same is not None:
            said.append(f"{same} is now called {name}")
            gone.remove(same)
            new.remove(name)
    said += [f"{name} is new" for name in new]
    said += [f"{name} is gone" for name in gone]
    return said + [f"{name} has another content" for name in now if name in was and was[name] != now[name]]


def _flat(values: Any, path: str = "") -> dict[str, Any]:
    """Options by their names as in `--set`; an empty mapping is none at all."""
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
    return [f"{words}: {_some(changes)}"] if changes else []


def _shown(values: Mapping[str, Any], name: str) -> str:
    if name not in values:
        return _NOTHING
    value = values[name]
    if value is None or isinstance(value, bool):
        return {None: "none", True: "true", False: "false"}[value]
    return str(value)


def _some(changes: list[str]) -> str:
    more = len(changes) - _SHOWN
    return ", ".join(changes[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
