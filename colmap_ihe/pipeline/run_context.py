"""Hold one run over a project, as its stages see it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from colmap_ihe.photographs.discover import Capture, Discovery
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.resource_needs import StageNeeds
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.recipe import recipe_from_dict

Record = dict[str, Any]
"""The record of a finished stage, as on disk."""
Inputs = Mapping[str, Mapping[str, str]]
"""The user's files that a stage reads, by kind and name, with the digest of their content."""


@dataclass
class RunContext:
    """Hold what a run was given, and what its stages have found so far.

    `records` holds the records of the stages before this one; `resumed` is True if this stage was begun
    with the same fingerprint and not finished, so that its files may be kept. `developed`: where RAW photographs are
    kept developed for other runs on them, if anywhere. `digests` as `digests_of` found them when the run began, and
    `inputs` of them by stage, kind and name. `needs` of its stages, by name, once `captures` is done.
    """

    project: Project
    options: Options
    discovery: Discovery
    executor: Executor
    records: dict[str, Record] = field(default_factory=dict)
    resumed: bool = False
    surveyed: list[Surveyed] = field(default_factory=list)
    developed: Path | None = None
    digests: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    needs: Mapping[str, StageNeeds] = field(default_factory=dict)
    inputs: Mapping[str, Inputs] = field(default_factory=dict)

    @property
    def strict(self) -> bool:
        return self.options.captures.strict

    @property
    def contents(self) -> Mapping[str, str]:
        """Return the digest of each photograph's content by name."""
        return self.inputs.get("captures", {}).get("photographs", {})

    def captures(self) -> list[Capture]:
        """Return the captures that every stage so far could use, with their recipes."""
        out: set[str] = set()
        for record in self.records.values():
            out |= set(record.get("left_out", {}))
        first = self.records["captures"]
        recipes = {
            name: recipe_from_dict(values, self.project.masters) for name, values in first["recipes"].items()
        }
        known = {s.capture.name: s.capture for s in self.surveyed}
        return [
            known.get(c.name)
            or self.kept(replace(c, recipe=recipes.get(c.name, c.recipe), pixels=first["largest"]))
            for c in self.discovery.captures
            if c.name not in out
        ]

    def kept(self, capture: Capture) -> Capture:
        """Return the capture, to be kept developed if those of this run are."""
        if self.developed is None or capture.kind != "raw":
            return capture
        return replace(capture, recipe=replace(capture.recipe, cache_folder=str(self.developed)))

    def grey_names(self) -> list[str]:
        """Return the names of the grey images."""
        return sorted(self.records["convert"]["grey"].values())

    def photographs_by_grey(self) -> dict[str, str]:
        """Return the names of the photographs by those of their grey images."""
        return {grey: name for name, grey in self.records["convert"]["grey"].items()}
