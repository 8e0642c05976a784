"""Read options from project.yaml, then from `stage.option=value`: strictly, and refused by name.

project.yaml comes with a folder that somebody may have been sent, and so does a record: what they name cannot lead out
of the project, nor to a machine elsewhere. On the command line anything may be named.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Collection, Iterable, Iterator, Mapping
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pydantic import ValidationError

from colmap_ihe.errors import OptionError, did_you_mean
from colmap_ihe.project.options import KnownCamera, Options
from colmap_ihe.project.safe_yaml import parse_yaml, read_yaml, refuse_no_text

_SHOWN = 200  # characters of a value in a message
_OUR_FILES = {"fit.weights": "--weights FILE", "camera.calibration": "--set camera.calibration=FILE"}
"""Options that name a file which we read ourselves, with how the user says it on the command line."""
_NATIVE = re.compile(r"(path|file|folder|directory|dir|list)$")
"""By which COLMAP's options that name files are told, as snapshot_path and trust_region_problem_dump_directory."""


def load_options(path: Path | None, assignments: Iterable[str] = ()) -> Options:
    """Return the defaults, changed by project.yaml at `path` if there is one, then by `stage.option=value` each. Raises
    `OptionError`."""
    values: dict[str, Any] = {}
    source = "project.yaml"
    if path is not None and path.exists():
        source = str(path)
        values = _read_yaml(path)
    return options_of(values, source, path.parent if path else Path(), assignments)


def options_of(values: dict[str, Any], source: str, root: Path, assignments: Iterable[str] = ()) -> Options:
    """Return the defaults, changed by sections of `values`, which come from `source` and may name nothing outside
    of `root`, then by `stage.option=value` each, which may. Raises `OptionError`."""
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
        values = read_yaml(path)
    except ValueError as error:
        quotes = "scanning an alias" in str(error)
        hint = 'put patterns into quotes, as in "*":' if quotes else "correct or remove it"
        raise OptionError(f"{path}: not readable as YAML: {error}", hint=hint) from error
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
        message = first["msg"].removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            known = _known(first["loc"])
            near = did_you_mean(str(first["loc"][-1]), known)
            hint = f"{near} " if near else ""
            raise OptionError(
                f"{source}: unknown option {place!r}", hint=f"{hint}known there: {', '.join(known)}"
            ) from error
        raise OptionError(
            f"{source}: {place} is {first['input']!r:.{_SHOWN}}; {message[:1].lower()}{message[1:]}",
            hint="see docs/options.md",
        ) from error


def _known(location: tuple[int | str, ...]) -> list[str]:
    section = Options.model_fields.get(str(location[0]))
    if len(location) == 1 or section is None:
        return list(Options.model_fields)
    if location[0] == "cameras":
        return list(KnownCamera.model_fields)
    return list(type(section.default).model_fields)


def named_paths(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield key, as in `--set`, and text of every option in sections of project.yaml that names something elsewhere."""
    for section, options in values.items():
        for name, value in options.items() if isinstance(options, Mapping) else ():
            key = f"{section}.{name}"
            if (key in _OUR_FILES or key == "cluster.address") and isinstance(value, str):
                yield key, value
            elif section != "cameras" and isinstance(value, Mapping):  # what goes to pycolmap as it is
                yield from _native_paths(key, value)


def _native_paths(place: str, values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        key = f"{place}.{name}"
        if isinstance(value, Mapping):
            yield from _native_paths(key, value)
        elif isinstance(value, str) and value and _NATIVE.search(str(name)):
            yield key, value


def refuse_paths(values: Mapping[str, Any], source: str, root: Path, said: Collection[str]) -> None:
    """Raise `OptionError` for what `values`, read from a file, may not name; `said` are the keys that the command line
    goes over. `root`: the project's folder."""
    for key, text in named_paths(values):
        if key in said:
            continue
        if key == "cluster.address":
            if not text.startswith("local") and not _is_near(text):
                raise OptionError(
                    f"{source}: {key} is {text!r:.200}; a scheduler can run anything on this machine, so a file names"
                    " none outside of your own network",
                    hint="say it yourself: --cluster ADDRESS",
                )
        elif key not in _OUR_FILES:
            raise OptionError(
                f"{source}: {key} is {text!r:.200}; files that COLMAP reads or writes are not named by a file",
                hint=f"if you want it, say it yourself: --set {key}=PATH",
            )
        elif not _is_within(root, text):
            raise OptionError(
                f"{source}: {key} is {text!r:.200}, which leads out of the project",
                hint=f"put the file into the project's folder, or say it yourself: {_OUR_FILES[key]}",
            )


def _is_near(address: str) -> bool:
    """Tell whether it is one of a host whose addresses are all of private networks or this machine."""
    try:
        host = urlsplit(address).hostname
        found = socket.getaddrinfo(host, None) if host else []
        return bool(found) and all(ip_address(str(a[4][0]).partition("%")[0]).is_private for a in found)
    except (OSError, ValueError):
        return False


def _is_within(root: Path, text: str) -> bool:
    """Tell whether it is a relative path that ends below `root`, links followed."""
    if Path(text).is_absolute():
        return False
    try:
        return Path(os.path.realpath(root / text)).is_relative_to(os.path.realpath(root))
    except (OSError, ValueError):
        return False


def project_options(project: Path, assignments: list[str]) -> Options:
    return load_options(project / "project.yaml", assignments)
