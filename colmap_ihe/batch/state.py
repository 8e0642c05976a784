"""Describe a batch project by project: for programs as batch.json, for people as a page and in words."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import simplejpeg

from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.errors import KnownError
from colmap_ihe.machine.files import read_at_most, read_json, write_bytes, write_json
from colmap_ihe.pipeline.job import Ending
from colmap_ihe.project.folder import Project
from colmap_ihe.report.charts import duration
from colmap_ihe.report.contents import BatchContents, Picture, ProjectRow
from colmap_ihe.report.page import render_batch

State = Literal["copying", "waiting", "running"] | Ending
Phase = Literal["running", "watching", "stopped", "finished"]
_Kind = Literal["done", "failed", "running", "waiting"]

_IN_WORDS: dict[State, tuple[str, _Kind]] = {
    "copying": ("photographs are arriving", "waiting"),
    "waiting": ("waiting", "waiting"),
    "running": ("running", "running"),
    "busy": ("in use by another run", "waiting"),
    "stopped": ("stopped", "waiting"),
    "done": ("done", "done"),
    "failed": ("failed", "failed"),
    "crashed": ("crashed", "failed"),
    "out_of_memory": ("out of memory", "failed"),
    "timed_out": ("out of time", "failed"),
}
_REFRESH_SECONDS = 10
_PICTURE_BYTES = 1_000_000
_COUNTED = {"points3D": "points", "dense_points": "dense points", "mesh_faces": "faces"}
_FIGURES = ("images", "registered_images", "mean_reprojection_error_px", "check_rms_mm", *_COUNTED)
_METRIC_BY = {
    "control_points": "control points",
    "scale_bars": "scale bars",
    "positions": "positions",
    "gps": "GPS",
}


@dataclass(frozen=True)
class ProjectState:
    """Describe a project of a batch, by the fields of docs/batch.md. Figures that no stage has made are None."""

    name: str
    state: State
    reason: str = ""
    hint: str = ""
    stage: str = ""
    progress: tuple[int, int] | None = None
    photographs: int | None = None
    figures: dict[str, Any] = field(default_factory=dict)
    metric_by: str | None = None
    left_out: int = 0
    warnings: int = 0
    stages: dict[str, float] = field(default_factory=dict)
    seconds: float | None = None
    peak_memory_gb: float | None = None
    began: str | None = None
    ended: str | None = None
    page: str | None = None
    log: str | None = None

    @property
    def kind(self) -> _Kind:
        return _IN_WORDS[self.state][1]

    @property
    def in_words(self) -> str:
        words = _IN_WORDS[self.state][0]
        if self.state == "running" and self.stage:
            done = f" {self.progress[0]} of {self.progress[1]}" if self.progress and self.progress[1] else ""
            return f"{words}: {self.stage}{done}"
        return words

    def as_dict(self) -> dict[str, Any]:
        values = asdict(self)
        return {**{k: v for k, v in values.items() if k != "figures"}, **values["figures"]}


@dataclass(frozen=True)
class BatchState:
    """Describe a batch, and when it began. `command` goes on with it."""

    root: str
    phase: Phase
    projects: Sequence[ProjectState]
    began: str
    remaining_s: float | None = None
    command: str = ""
    warnings: Sequence[str] = ()

    @property
    def succeeded(self) -> bool:
        return all(project.state == "done" for project in self.projects)

    @property
    def ended(self) -> int:
        """Return how many projects are done or failed."""
        return sum(project.kind in ("done", "failed") for project in self.projects)

    def as_dict(self) -> dict[str, Any]:
        values = {
            "root": self.root,
            "state": self.phase,
            "began": self.began,
            "updated": time_of(time.time()),
            "remaining_s": None if self.remaining_s is None else round(self.remaining_s),
            "counts": dict(Counter(project.state for project in self.projects)),
            "projects": [project.as_dict() for project in self.projects],
            "warnings": list(self.warnings),
        }
        text = json.dumps(values, ensure_ascii=False)  # names that are not UTF-8 can be in no file
        return dict(json.loads(text.encode("utf-8", "replace")))

    def in_words(self) -> str:
        """Return the state of the batch in one line, as "3 of 8 projects done, 1 failed"."""
        kinds: Counter[str] = Counter(project.kind for project in self.projects)
        parts = [f"{kinds['done']} of {len(self.projects)} projects done"]
        words = {"failed": "failed", "running": "running", "waiting": "not begun or not finished"}
        parts += [f"{kinds[kind]} {word}" for kind, word in words.items() if kinds[kind]]
        if self.phase in ("running", "watching") and self.remaining_s is not None:
            long = self.remaining_s >= 10
            parts.append(f"about {duration(self.remaining_s)} left" if long else "a few seconds left")
        elif self.phase == "stopped":
            parts.append("stopped by hand")
        elif self.phase == "watching":
            parts.append("watching for more")
        return ", ".join(parts)


def time_of(seconds: float) -> str:
    """Return seconds since the epoch as batch.json has them: UTC, ISO 8601."""
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="seconds")


def project_state(folder: BatchFolder, project: Project, state: State, **values: Any) -> ProjectState:
    """Describe a project as its records do, with `values` over it."""
    record = read_json(project.batch_record) or {}
    summary = read_json(project.summary_file) or {}
    stages = summary.get("stages")
    recorded: dict[str, Any] = {
        "seconds": _number(record.get("seconds")),
        "peak_memory_gb": _number(record.get("peak_memory_gb")),
        "began": _text(record.get("began")),
        "ended": _text(record.get("ended")),
        "figures": {name: _number(summary.get(name)) for name in _FIGURES},
        "metric_by": _text(summary.get("metric_by")),
        "left_out": _length(summary.get("left_out")),
        "warnings": _length(summary.get("warnings")),
        "stages": {str(n): s for n, s in stages.items() if _number(s)} if isinstance(stages, dict) else {},
        "page": _relative(folder, project.page_file),
        "log": _relative(folder, project.batch_log),
    }
    return ProjectState(folder.name_of(project.root), state, **{**recorded, **values})


def _number(value: Any) -> Any:
    """Return None for what no run wrote there."""
    return value if type(value) in (int, float) and 0 <= value < 1e15 else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _length(value: Any) -> int:
    return len(value) if isinstance(value, list | dict) else 0


def publish(folder: BatchFolder, state: BatchState, thumbnails: dict[str, Picture]) -> None:
    """Write the page and batch.json, each whole or not at all. Raises `KnownError`s."""
    write_json(folder.json_file, state.as_dict())
    going_on = state.phase in ("running", "watching")
    contents = BatchContents(
        title=f"{folder.root.name}: {len(state.projects)} projects",
        result=f"{state.in_words()}.",
        rows=[
            _row(project, _model_picture(folder, project) or thumbnails.get(project.name))
            for project in state.projects
        ],
        command=state.command,
        written=datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %Z"),
        again_s=_REFRESH_SECONDS if going_on else None,
        warnings=state.warnings,
    )
    write_bytes(folder.page_file, render_batch(contents).encode())


def _model_picture(folder: BatchFolder, project: ProjectState) -> Picture | None:
    """Return the picture of the model of a project that is done, if it can be read."""
    if project.state != "done":
        return None
    try:
        jpeg = read_at_most(Project.at(folder.root / project.name).picture_file, _PICTURE_BYTES)
        height, width, *_ = simplejpeg.decode_jpeg_header(jpeg)
    except (OSError, ValueError, KnownError):
        return None
    return Picture(jpeg, width, height, f"the model of {project.name}")


def _relative(folder: BatchFolder, file: Path) -> str | None:
    return os.path.relpath(file, folder.folder) if file.exists() else None


def _row(project: ProjectState, thumbnail: Picture | None) -> ProjectRow:
    page, log = (quote((p or "").encode("utf-8", "surrogateescape")) for p in (project.page, project.log))
    name, kind, words, facts = project.name, project.kind, project.in_words, facts_of(project)
    return ProjectRow(name, kind, words, page, thumbnail, facts, project.reason, project.hint, log)


def facts_of(project: ProjectState) -> list[tuple[str, str]]:
    """Return the figures of a project as a person reads them, as many as there are."""
    figures = project.figures
    images, error = figures.get("images") or project.photographs, figures.get("mean_reprojection_error_px")
    facts: list[tuple[str, str]] = []
    if figures.get("registered_images") is not None:
        facts.append(("registered images", f"{figures['registered_images']} of {images}"))
    elif images:
        facts.append(("photographs", str(images)))
    if error is not None:
        facts.append(("mean reprojection error", f"{error:.2f} px"))
    if project.metric_by in _METRIC_BY:
        facts.append(("metres by", _METRIC_BY[project.metric_by]))
        if figures.get("check_rms_mm") is not None:
            facts.append(("check points", f"{figures['check_rms_mm']:.1f} mm RMS"))
    for name, words in _COUNTED.items():
        if figures.get(name) is not None:
            facts.append((words, f"{figures[name]:,}"))
    for count, words in ((project.left_out, "left out"), (project.warnings, "warnings")):
        if count:
            facts.append((words, str(count)))
    if project.stages:
        facts.append(("time", duration(sum(project.stages.values()))))
    return facts
