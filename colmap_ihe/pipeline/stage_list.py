"""The road from photographs to a coloured mesh: which stages there are, and whether what one left still holds.

A stage is up to date if its record carries the fingerprint that it would have now: of the options that
affect its result, of the versions of what computes it, and of the stage before it. The first link of that
chain is the content of the photographs. Never is anything skipped because a file is there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.machine.files import digest_file, fingerprint_of
from colmap_ihe.machine.libraries import __version__, library_versions
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline import outputs, stages
from colmap_ihe.pipeline.input_digests import FRAMES, masks_in
from colmap_ihe.pipeline.run_context import Record, RunContext
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


@dataclass(frozen=True)
class Stage:
    """One stop on the road. `options` names the sections, `libraries` the modules, that affect its result."""

    name: str
    run: Callable[[RunContext, Progress], Record]
    options: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()


_DECODERS = ("rawpy", "libraw", "pillow", "simplejpeg", "tifffile")
STAGES = (
    Stage("captures", stages.captures, ("develop", "cameras"), ("rawpy", "libraw")),
    Stage("fit", stages.fit, ("fit",), (*_DECODERS, "numpy")),
    Stage("convert", stages.convert, ("convert",)),
    Stage("features", stages.features, ("camera", "features"), ("pycolmap",)),
    Stage("matches", stages.matches, ("matches",)),
    Stage("sparse", stages.sparse, ("sparse",)),
    Stage("dense", stages.dense, ("dense",), ("opencv", "numpy")),
    Stage("mesh", stages.mesh, ("mesh",)),
)
STAGE_NAMES = tuple(stage.name for stage in STAGES)
INPUT_CHANGED = "what it reads changed"
Inputs = Mapping[str, Mapping[str, str]]
"""Of a stage, the user's files by kind and name, with what tells their content."""


def switched_off(stage: str, options: Options) -> str:
    """The section whose `enabled` switches the stage off, empty if none does."""
    switches = {"dense": ("dense",), "mesh": ("dense", "mesh")}.get(stage, ())
    return next((name for name in switches if not getattr(options, name).enabled), "")


def why_stale(project: Project, stage: Stage, record: Record, prints: Mapping[str, str]) -> str:
    """Why a record does not count, empty if it does."""
    if record.get("fingerprint") != prints[stage.name]:
        return INPUT_CHANGED
    if gone := outputs.missing(stage.name, project, record):
        return _of_files(gone, "gone")
    if altered := outputs.altered(stage.name, project, record):
        return _of_files(altered, "damaged" if stage.name == "features" else "not as it was written")
    return ""


def _of_files(files: Sequence[Path], what: str) -> str:
    if len(files) == 1:
        return f"{files[0].name} is {what}"
    return f"{files[0].name} and {len(files) - 1} more files are {what.replace('it was', 'they were')}"


def options_of_stage(options: Options, stage: Stage) -> dict[str, Any]:
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
        chosen["mesh"]["texture"] = options.mesh.texture is not False  # auto is true
    return chosen


def versions_of(stage: Stage) -> dict[str, str]:
    return {"colmap-ihe": __version__, **library_versions(*stage.libraries)}


def inputs_of(
    project: Project, options: Options, discovery: Discovery, digests: Mapping[str, list[Any]]
) -> dict[str, Inputs]:
    """By stage, what it reads of the user's files."""
    weights = options.fit.weights
    return {
        "captures": {
            "photographs": {c.name: str(digests[c.name][-1]) for c in discovery.captures},
            "names of grey images": {c.name: c.grey_stem for c in discovery.captures},
            "JPEG files beside RAW": {c.name: ", ".join(c.paired) for c in discovery.captures if c.paired},
            "calibration frames": {
                name.removeprefix(FRAMES): str(found[-1])
                for name, found in digests.items()
                if name.startswith(FRAMES)
            },
        },
        "fit": {}
        if weights is None
        else {"weights": {"their file": _content_of_weights(project.root / weights)}},
        "features": {"masks": masks_in(project.masks)},
    }


def fingerprints(options: Options, inputs: Mapping[str, Inputs]) -> dict[str, str]:
    """What the record of each stage would have to carry to be true now."""
    before = ""
    prints: dict[str, str] = {}
    for stage in STAGES:
        chosen, read = options_of_stage(options, stage), inputs.get(stage.name, {})
        before = fingerprint_of(stage.name, chosen, versions_of(stage), read, before)
        prints[stage.name] = before
    return prints


def _content_of_weights(file: Path) -> str:
    try:
        return digest_file(file)
    except OSError:  # the stage says so
        return ""
