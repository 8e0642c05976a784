"""Read options from project.yaml, then from `stage.option=value`: strictly, and refused by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from colmap_ihe.errors import OptionError
from colmap_ihe.machine.files import read_at_most
from colmap_ihe.project.option_paths import refuse_paths
from colmap_ihe.project.options import KnownCamera, Options
from colmap_ihe.project.safe_yaml import MOST_BYTES, parse_yaml, refuse_no_text

_SHOWN = 200  # characters of a value in a message


def load_options(path: Path | None, assignments: Iterable[str] = ()) -> Options:
    """Return the defaults, changed by project.yaml at `path` if there is one, then by `stage.option=value` each.

    Raises `OptionError`.
    """
    values: dict[str, Any] = {}
    source = "project.yaml"
    if path is not None and path.exists():
        source = str(path)
        values = _read_yaml(path)
    return options_of(values, source, path.parent if path else Path(), assignments)


def options_of(values: dict[str, Any], source: str, root: Path, assignments: Iterable[str] = ()) -> Options:
    """Return the defaults, changed by sections of `values`, which come from `source` and may name nothing outside
    of `root`, then by `stage.option=value` each, which may.

    Raises `OptionError`.
    """
    try:
        refuse_no_text(values)
    except (ValueError, RecursionError) as error:
        raise OptionError(f"{source}: {error}", hint="correct or remove it") from error
    _validate(values, source)
    assignments = list(assignments)
    refuse_paths(values, source, root, [text.partition("=")[0].strip() for text in assignments])
    for assignment in assignments:
        _assign(values, assignment)
        _validate(values, f"--set {_shown(assignment)}")
    return _validate(values, source)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        values = parse_yaml(read_at_most(path, MOST_BYTES).decode("utf-8"))
    except (OSError, ValueError) as error:
        problem = (error.strerror if isinstance(error, OSError) else None) or str(error)
        hint = (
            'put patterns into quotes, as in "*":'
            if "scanning an alias" in problem
            else "correct or remove it"
        )
        raise OptionError(f"{path}: not readable as YAML: {problem}", hint=hint) from error
    if values is None:
        return {}
    if isinstance(values, dict) and isinstance(values.get("cluster"), str):
        values["cluster"] = {"address": values["cluster"]}
    if not isinstance(values, dict) or not all(isinstance(v, dict | None) for v in values.values()):
        raise OptionError(
            f"{path}: holds {type(values).__name__}, expected sections such as `dense:` with options below them",
            hint="see docs/options.md",
        )
    return {str(k): dict(v or {}) for k, v in values.items()}


def _assign(values: dict[str, Any], assignment: str) -> None:
    name, equals, text = assignment.partition("=")
    stage, dot, option = name.strip().partition(".")
    if not equals or not dot or not stage or not option:
        raise OptionError(
            f"--set {_shown(assignment)}: expected stage.option=value", hint="as in --set dense.backend=sgm"
        )
    try:
        value = parse_yaml(text)
    except ValueError as error:
        raise OptionError(
            f"--set {_shown(assignment)}: the value is not readable as YAML ({error})"
        ) from error
    target = values.setdefault(stage, {})
    *parents, last = option.split(".") if stage != "cameras" else _pattern_and_key(option, value)
    for parent in parents:  # colmap options nest: features.colmap.sift.max_num_features=4096
        target = target.setdefault(parent, {})
        if not isinstance(target, dict):
            raise OptionError(f"--set {_shown(assignment)}: {parent!r} is not a mapping")
    target[last] = value


def _shown(assignment: str) -> str:
    """Return a value in one line, as it stands in a message."""
    return " ".join(assignment.split())[:_SHOWN]


def _pattern_and_key(option: str, value: Any) -> list[str]:
    """Split a key whose pattern holds dots: the key comes behind the last one, `cameras.*.JPG.focal_length=24`; a
    mapping is all of a pattern, `cameras.*.JPG={focal_length: 24}`."""
    pattern, dot, key = option.rpartition(".")
    return [option] if isinstance(value, dict) or not dot else [pattern, key]


def _validate(values: Mapping[str, Any], source: str) -> Options:
    try:
        return Options.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])[:_SHOWN]
        if first["type"] == "extra_forbidden":
            raise OptionError(
                f"{source}: unknown option {place!r}", hint=f"known there: {_known(first['loc'])}"
            ) from error
        raise OptionError(
            f"{source}: {place} is {first['input']!r:.{_SHOWN}}; {_worded(first['msg'])}",
            hint="see docs/options.md",
        ) from error


def _worded(message: str) -> str:
    message = message.removeprefix("Value error, ")
    return message[:1].lower() + message[1:]


def _known(location: tuple[int | str, ...]) -> str:
    section = Options.model_fields.get(str(location[0]))
    if len(location) == 1 or section is None:
        return ", ".join(Options.model_fields)
    if location[0] == "cameras":
        return ", ".join(KnownCamera.model_fields)
    return ", ".join(type(section.default).model_fields)


def project_options(project: Path, assignments: list[str]) -> Options:
    return load_options(project / "project.yaml", assignments)
