"""Note what a run's result depends on in records/run.json, so that the run can be repeated, and tell what differs."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import cuda_devices, pycolmap
from colmap_ihe.errors import OptionError
from colmap_ihe.machine import threads
from colmap_ihe.machine.files import read_json, write_json
from colmap_ihe.machine.libraries import __version__, code_digest, library_versions, package_version
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.machine.words import listed
from colmap_ihe.pipeline.given_control import control_digests
from colmap_ihe.pipeline.input_digests import digest_if_there, masks_in
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import options_of

_HINT = "name a project that `reconstruct` ran on, or its records/run.json"
_MACHINE = ("system", "libc", "instructions", "linear algebra", "cuda devices")  # what may change numbers
_PACKAGES = (
    *("numpy", "opencv-python-headless", "pillow", "simplejpeg", "isal", "tifffile", "threadpoolctl"),
    *("PyWavelets", "colour-science", "scipy", "xatlas", "trimesh"),  # some of them only with an extra
)
_CPU_INFO = Path("/proc/cpuinfo")
_INSTRUCTIONS = re.compile(r"(sse4|avx|fma|f16c|bmi|amx|asimd|sve|neon)\w*")
_VARIABLES = re.compile(r"(OMP|GOMP|KMP|MKL|OPENBLAS|NPY|OPENCV|CUDA|GLOG|PYTHONHASHSEED|MALLOC)(_\w+)?")
_PLAIN = re.compile(r"[\w.,:;=+ -]{0,80}")
_GIT_SECONDS = 5.0


@dataclass(frozen=True)
class RunRecord:
    """Hold what a run noted. `photographs`, `masks` and `control`: digest of the content by name; calibration
    frames are among the photographs. `weights`, `calibration`: the digest of the file that was given, empty for none.
    `machine` and `variables` as `write_run_record` notes them, empty in older records."""

    options: Options
    versions: Mapping[str, str]
    photographs: Mapping[str, str]
    masks: Mapping[str, str] = field(default_factory=dict)
    control: Mapping[str, str] = field(default_factory=dict)
    weights: str = ""
    calibration: str = ""
    threads: int = 0
    machine: Mapping[str, Any] = field(default_factory=dict)
    variables: Mapping[str, str] = field(default_factory=dict)


def write_run_record(
    project: Project, options: Options, digests: Mapping[str, Sequence[Any]]
) -> dict[str, Any]:
    """Write records/run.json, and return what it holds. Where work runs is left out, as it affects no result and says
    whose machines they are."""
    settings = options.as_yaml()
    del settings["cluster"]
    values = {
        "options": settings,
        "seed": options.sparse.seed,
        "threads": local_workers(),
        "photographs": {name: values[-1] for name, values in digests.items()},
        "masks": masks_in(project.masks),
        "control": control_digests(project, options),
        "weights": _digest_of(project, options.fit.weights),
        "calibration": _digest_of(project, options.camera.calibration),
        "versions": _versions(),
        "commit": _commit(),
        "machine": _machine(),
        "environment": _variables(),
    }
    write_json(project.run_file, values)
    return values


def read_run(path: Path, assignments: Sequence[str] = ()) -> RunRecord:
    """Read the run record of a project, or the file itself, its options changed by `stage.option=value` each. Weights
    and calibration files are those of the project. Raises `OptionError`."""
    file = path / "records" / "run.json" if path.is_dir() else path
    values = read_json(file) or {}
    parts = [
        values[name] for name in ("options", "versions", "photographs") if isinstance(values.get(name), dict)
    ]
    if len(parts) < 3 or not all(isinstance(v, str) for part in parts[1:] for v in part.values()):
        raise OptionError(f"{file}: is not there, or not the record of a run", hint=_HINT)
    options, versions, photographs = parts
    root = file.absolute().parents[1 if file.absolute().parent.name == "records" else 0]
    weights = _noted_file(options, "fit", "weights")
    calibration = _noted_file(options, "camera", "calibration")
    settings = options_of(options, str(file), root, assignments)
    settings = _with_file_of(root, settings, "fit", "weights", weights)
    settings = _with_file_of(root, settings, "camera", "calibration", calibration)
    more = {name: values.get(name) for name in ("masks", "control", "machine")}
    more["variables"] = values.get("environment")
    return RunRecord(
        settings,
        versions,
        photographs,
        weights=str(values.get("weights") or ""),
        calibration=str(values.get("calibration") or ""),
        threads=values["threads"] if isinstance(values.get("threads"), int) else 0,
        **{name: part if isinstance(part, dict) else {} for name, part in more.items()},
    )


def _noted_file(options: Mapping[str, Any], section: str, name: str) -> Any:
    """Return what an option that names a file was noted as, None for nothing."""
    values = options.get(section)
    return values.get(name) if isinstance(values, dict) else None


def _with_file_of(root: Path, settings: Options, section: str, name: str, noted: Any) -> Options:
    """Return the options with the file that one of them names found from `root`, if it is the one that was noted."""
    options = getattr(settings, section)
    if not noted or getattr(options, name) != noted:
        return settings
    return settings.model_copy(update={section: options.model_copy(update={name: str(root / noted)})})


def differences_from(
    noted: RunRecord, project: Project, options: Options, digests: Mapping[str, Sequence[Any]]
) -> list[str]:
    """Say in sentences what is not as it was when the run was noted."""
    differences = _other_software(noted)
    differences += _other_files("photographs", noted.photographs, {n: v[-1] for n, v in digests.items()})
    if noted.machine:
        differences += _other_files("masks", noted.masks, masks_in(project.masks))
        differences += _other_files("files of control/", noted.control, control_digests(project, options))
        if noted.weights != _digest_of(project, options.fit.weights):
            differences.append("the weights file has another content than in the record")
        if noted.calibration != _digest_of(project, options.camera.calibration):
            differences.append("the calibration file has another content than in the record")
    if noted.threads and noted.threads != local_workers():
        words = (
            f"the record is of {noted.threads} threads, this is of {local_workers()}: the result may differ"
        )
        more = noted.threads < threads.cores()
        differences.append(f"{words} (--threads {noted.threads})" if more else words)
    return differences


def _other_software(noted: RunRecord) -> list[str]:
    was, now = dict(noted.versions), _versions()
    if noted.machine:
        machine, variables = _machine(), _variables()
        now |= {name: _words(machine[name]) for name in _MACHINE}
        was |= {name: _words(noted.machine.get(name, "none")) for name in _MACHINE}
        now |= variables
        was |= noted.variables
    else:  # a record from before all of them were noted
        now = {name: version for name, version in now.items() if name in was}
        was.pop("machine", None)
    return [
        f"the record is of {name} {was.get(name, 'none')}, this is {now.get(name, 'none')}: the result may differ"
        for name in sorted({*now, *was})
        if was.get(name, "none") != now.get(name, "none")
    ]


def _other_files(kind: str, noted: Mapping[str, str], present: Mapping[str, str]) -> list[str]:
    differences = []
    other = sorted(name for name in present.keys() & noted.keys() if present[name] != noted[name])
    for names, words in (
        (sorted(noted.keys() - present.keys()), "of the record are not here"),
        (sorted(present.keys() - noted.keys()), "are not in the record"),
        (other, "have another content than in the record"),
    ):
        if names:
            differences.append(f"{len(names)} {kind} {words}: {listed(names)}")
    return differences


def _digest_of(project: Project, file: str | None) -> str:
    """Return the digest of a file that an option names, empty where there is none."""
    return "" if file is None else digest_if_there(project.root / file)


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _versions() -> dict[str, str]:
    """Return the version of everything that computes, by name, as far as it is installed."""
    packages = {name: package_version(name) for name in _PACKAGES}
    return {
        "colmap-ihe": __version__,
        "code of colmap-ihe": code_digest(),
        "python": platform.python_version(),
        **library_versions("pycolmap", "opencv", "rawpy", "libraw"),
        "COLMAP": pycolmap.COLMAP_version.removeprefix("COLMAP "),
        **{name: version for name, version in packages.items() if version is not None},
    }


def _machine() -> dict[str, Any]:
    """Return what libraries choose their code by, and how many cores there are; nothing says whose machine it is."""
    about = _CPU_INFO.read_text(encoding="utf-8", errors="replace") if _CPU_INFO.exists() else ""
    words = {line.partition(":")[0].strip(): line.partition(":")[2].strip() for line in about.splitlines()}
    flags = words.get("flags", words.get("Features", "")).split()
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "libc": " ".join(platform.libc_ver()).strip(),
        "processor": words.get("model name", platform.processor()),
        "instructions": sorted(flag for flag in flags if _INSTRUCTIONS.fullmatch(flag)),
        "linear algebra": threads.blas_libraries(),
        "cuda devices": cuda_devices(),
        "cores": threads.cores(),
    }


def _variables() -> dict[str, str]:
    """Return the environment variables that libraries listen to. A value that may hold a path is not told."""
    heard = {name: value for name, value in os.environ.items() if _VARIABLES.fullmatch(name)}
    return {name: heard[name] if _PLAIN.fullmatch(heard[name]) else "(not told)" for name in sorted(heard)}


def _commit() -> str | None:
    """Return the commit of the clone that this package runs from, with a note of changes; None elsewhere."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    answers = []
    with suppress(OSError, subprocess.SubprocessError):  # no git, or not its owner's
        for question in (["rev-parse", "HEAD"], ["status", "--porcelain", "--", "colmap_ihe"]):
            command = ["git", "-C", str(root), *question]
            answers.append(
                subprocess.run(command, capture_output=True, text=True, check=True, timeout=_GIT_SECONDS)
            )
    if len(answers) < 2:
        return None
    return answers[0].stdout.strip() + (" with changes" if answers[1].stdout.strip() else "")
