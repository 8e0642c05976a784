"""What a run notes of itself in records/run.json, so that it can be run again: options, versions, photographs."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.errors import OptionError
from colmap_ihe.executor import local_workers
from colmap_ihe.files import read_json, write_json
from colmap_ihe.options import Options
from colmap_ihe.project import Project
from colmap_ihe.project_yaml import options_of
from colmap_ihe.version import __version__, library_versions

_HINT = "name a project that `reconstruct` ran on, or its records/run.json"
_SHOWN = 5


@dataclass(frozen=True)
class Noted:
    """What a run noted. `photographs`: by name the digest of the content."""

    options: Options
    versions: Mapping[str, str]
    photographs: Mapping[str, str]


def note_run(place: Project, options: Options, digests: Mapping[str, Sequence[Any]]) -> None:
    write_json(
        place.run_file,
        {
            "options": options.as_yaml(),
            "versions": _versions(),
            "cores": local_workers(),
            "photographs": {name: found[-1] for name, found in digests.items()},
        },
    )


def read_run(path: Path, assignments: Sequence[str] = ()) -> Noted:
    """Of a project, or of the file itself, its options changed by `stage.option=value` each. Raises `OptionError`."""
    file = path / "records" / "run.json" if path.is_dir() else path
    found = read_json(file) or {}
    parts = [
        found[name] for name in ("options", "versions", "photographs") if isinstance(found.get(name), dict)
    ]
    if len(parts) < 3 or not all(isinstance(v, str) for part in parts[1:] for v in part.values()):
        raise OptionError(f"{file}: is not there, or not the record of a run", hint=_HINT)
    options, versions, photographs = parts
    return Noted(options_of(options, str(file), file.parent.parent, assignments), versions, photographs)


def unlike(noted: Noted, digests: Mapping[str, Sequence[Any]]) -> list[str]:
    """In sentences, what is not as it was when the run was noted."""
    said = []
    now = _versions()
    for name in sorted({*now, *noted.versions}):
        was, is_now = noted.versions.get(name, "none"), now.get(name, "none")
        if was != is_now:
            said.append(f"the record is of {name} {was}, this is {is_now}: the result may differ")
    here = {name: found[-1] for name, found in digests.items()}
    other = sorted(n for n in here.keys() & noted.photographs.keys() if here[n] != noted.photographs[n])
    for names, words in (
        (sorted(noted.photographs.keys() - here.keys()), "of the record are not here"),
        (sorted(here.keys() - noted.photographs.keys()), "are not in the record"),
        (other, "have another content than in the record"),
    ):
        if names:
            shown = ", ".join(names[:_SHOWN]) + (" ..." if len(names) > _SHOWN else "")
            said.append(f"{len(names)} photographs {words}: {shown}")
    return said


def _versions() -> dict[str, str]:
    return {
        "colmap-ihe": __version__,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        **library_versions("pycolmap", "opencv", "rawpy", "libraw"),
    }
