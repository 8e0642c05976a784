"""Find and refuse options that name a file, a folder or a machine.

project.yaml comes with a folder that somebody may have been sent, and so does a record: what they name cannot lead out
of the project. On the command line anything may be named.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Collection, Iterator, Mapping
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from colmap_ihe.errors import OptionError

_NATIVE = re.compile(r"(path|file|folder|directory|dir|list)$")
"""By which COLMAP's options that name files are told, as snapshot_path and trust_region_problem_dump_directory."""


def named_paths(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Return key, as in `--set`, and text of every option in sections of project.yaml that names something outside
    of it."""
    for section, options in values.items():
        for name, value in options.items() if isinstance(options, Mapping) else ():
            key = f"{section}.{name}"
            if key in ("fit.weights", "cluster.address") and isinstance(value, str):
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
        elif key != "fit.weights":
            raise OptionError(
                f"{source}: {key} is {text!r:.200}; files that COLMAP reads or writes are not named by a file",
                hint=f"if you want it, say it yourself: --set {key}=PATH",
            )
        elif not _is_within(root, text):
            raise OptionError(
                f"{source}: {key} is {text!r:.200}, which leads out of the project",
                hint="put the file into the project's folder, or say it yourself: --weights FILE",
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
