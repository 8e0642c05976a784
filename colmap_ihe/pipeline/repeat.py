"""What a run notes of itself in records/run.json, so that it can be run again: all that its result depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from colmap_ihe.errors import OptionError
from colmap_ihe.machine import threads
from colmap_ihe.machine.files import digest_file, read_json, write_json
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline import environment as surroundings
from colmap_ihe.pipeline.input_digests import masks_in
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import options_of

_HINT = "name a project that `reconstruct` ran on, or its records/run.json"
_SHOWN = 5
_MACHINE = ("system", "libc", "instructions", "linear algebra", "cuda devices")  # what may change numbers


@dataclass(frozen=True)
class RunRecord:
    """What a run noted. `photographs` and `masks`: by name the digest of the content; calibration frames are among
    the photographs. `weights`: the digest of the file that was given, empty for none. `machine` and `variables` of the
    environment as in `surroundings`, empty in records of before they were noted."""

    options: Options
    versions: Mapping[str, str]
    photographs: Mapping[str, str]
    masks: Mapping[str, str] = field(default_factory=dict)
    weights: str = ""
    threads: int = 0
    machine: Mapping[str, Any] = field(default_factory=dict)
    variables: Mapping[str, str] = field(default_factory=dict)


def write_run_record(place: Project, options: Options, digests: Mapping[str, Sequence[Any]]) -> None:
    """Where work runs is left out, as it affects no result and says whose machines they are."""
    settings = options.as_yaml()
    del settings["cluster"]
    write_json(
        place.run_file,
        {
            "options": settings,
            "seed": options.sparse.seed,
            "threads": local_workers(),
            "photographs": {name: found[-1] for name, found in digests.items()},
            "masks": masks_in(place.masks),
            "weights": _weights(place, options),
            "versions": surroundings.versions(),
            "commit": surroundings.commit(),
            "machine": surroundings.machine(),
            "environment": surroundings.variables(),
        },
    )


def read_run(path: Path, assignments: Sequence[str] = ()) -> RunRecord:
    """Of a project, or of the file itself, its options changed by `stage.option=value` each. A weights file is that
    of the project. Raises `OptionError`."""
    file = path / "records" / "run.json" if path.is_dir() else path
    found = read_json(file) or {}
    parts = [
        found[name] for name in ("options", "versions", "photographs") if isinstance(found.get(name), dict)
    ]
    if len(parts) < 3 or not all(isinstance(v, str) for part in parts[1:] for v in part.values()):
        raise OptionError(f"{file}: is not there, or not the record of a run", hint=_HINT)
    options, versions, photographs = parts
    root = file.absolute().parents[1 if file.absolute().parent.name == "records" else 0]
    fit = options.get("fit")
    named = fit.get("weights") if isinstance(fit, dict) else None
    settings = options_of(options, str(file), root, assignments)
    if settings.fit.weights and settings.fit.weights == named:
        weights = str(root / named)
        settings = settings.model_copy(update={"fit": settings.fit.model_copy(update={"weights": weights})})
    more = {name: found.get(name) for name in ("masks", "machine")}
    more["variables"] = found.get("environment")
    return RunRecord(
        settings,
        versions,
        photographs,
        weights=str(found.get("weights") or ""),
        threads=found["threads"] if isinstance(found.get("threads"), int) else 0,
        **{name: values if isinstance(values, dict) else {} for name, values in more.items()},
    )


def differences_from(
    noted: RunRecord, place: Project, options: Options, digests: Mapping[str, Sequence[Any]]
) -> list[str]:
    """In sentences, what is not as it was when the run was noted."""
    said = _unlike_software(noted)
    said += _unlike_files("photographs", noted.photographs, {name: f[-1] for name, f in digests.items()})
    if noted.machine:
        said += _unlike_files("masks", noted.masks, masks_in(place.masks))
        if noted.weights != _weights(place, options):
            said.append("the weights file has another content than in the record")
    if noted.threads and noted.threads != local_workers():
        words = (
            f"the record is of {noted.threads} threads, this is of {local_workers()}: the result may differ"
        )
        said.append(f"{words} (--threads {noted.threads})" if noted.threads < threads.cores() else words)
    return said


def _unlike_software(noted: RunRecord) -> list[str]:
    was, now = dict(noted.versions), surroundings.versions()
    if noted.machine:
        here, variables = surroundings.machine(), surroundings.variables()
        now |= {name: _words(here[name]) for name in _MACHINE}
        was |= {name: _words(noted.machine.get(name, "none")) for name in _MACHINE}
        now |= variables
        was |= noted.variables
    else:  # of before all of them were noted
        now = {name: version for name, version in now.items() if name in was}
        was.pop("machine", None)
    return [
        f"the record is of {name} {was.get(name, 'none')}, this is {now.get(name, 'none')}: the result may differ"
        for name in sorted({*now, *was})
        if was.get(name, "none") != now.get(name, "none")
    ]


def _unlike_files(kind: str, noted: Mapping[str, str], here: Mapping[str, str]) -> list[str]:
    said = []
    other = sorted(name for name in here.keys() & noted.keys() if here[name] != noted[name])
    for names, words in (
        (sorted(noted.keys() - here.keys()), "of the record are not here"),
        (sorted(here.keys() - noted.keys()), "are not in the record"),
        (other, "have another content than in the record"),
    ):
        if names:
            shown = ", ".join(names[:_SHOWN]) + (" ..." if len(names) > _SHOWN else "")
            said.append(f"{len(names)} {kind} {words}: {shown}")
    return said


def _weights(place: Project, options: Options) -> str:
    """The digest of the weights file; the stage says where there is none."""
    file = place.root / options.fit.weights if options.fit.weights is not None else None
    return digest_file(file) if file is not None and file.is_file() else ""


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)
