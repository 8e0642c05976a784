"""Say when photographs are mapped once more, with what helps where the camera moved forward, and what came of it.

Down a street the camera moves along its own axis. COLMAP begins no model with such a pair of photographs, however well
it matches, and its own easing of that start (fewer matches, smaller angles) never reaches forward motion. So it finds
no model, or one of two photographs that happen to lie side by side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from colmap_ihe.colmap.checks.camera_motion import motions_of
from colmap_ihe.colmap.measures import joined_by_matches
from colmap_ihe.project.options import SparseOptions

EASIER: Mapping[str, float] = MappingProxyType(
    {
        "init_max_forward_motion": 1.0,  # 0.95: no pair whose second camera stands straight before the first
        "init_min_tri_angle": 4.0,  # 16 degrees
        "abs_pose_min_num_inliers": 15,  # 30; else many models of two photographs take up no third one
    }
)
"""Options of COLMAP's incremental mapper for the second try, with its own values in the comments. That these help, and
fewer matches to begin with do not, `benchmarks/second_try.py` shows: COLMAP halves their number itself, twice."""
_FEW = 3  # photographs; with two, no third one checks the points
_LEAST_MATCHES = 15  # of a pair that COLMAP's mappers look at, min_num_matches


@dataclass(frozen=True)
class SecondTry:
    """Describe a second try: the options that it changed, the photographs of the set, and those registered in the
    largest model of each try."""

    options: Mapping[str, float]
    images: int
    first: int
    second: int

    @property
    def helped(self) -> bool:
        """Return whether the second try registered more, so that its models are kept."""
        return self.second > self.first

    def in_words(self) -> str:
        """Say what was tried, what came of it, and which options a user may set."""
        settings = ", ".join(f"{name}: {value}" for name, value in self.options.items())
        way = f"`--set 'sparse.colmap.mapper={{{settings}}}'`"
        if not self.helped:
            second = f"no more than {self.first} of {self.images}" if self.first else "none either"
            return (
                "a second try with what helps where the camera moved forward, as down a street, registered"
                f" {second} ({way})"
            )
        first = f"only {self.first}" if self.first else "none"
        return (
            f"COLMAP registered {first} of {self.images} photographs, and {self.second} in a second try with what helps"
            f" where the camera moved forward, as down a street. That model began on less than COLMAP asks for: look"
            f" whether it is right. To spare the first try: {way}"
        )


def second_try_options(
    options: SparseOptions, registered: int, images: int, database: Path
) -> dict[str, float]:
    """Return the options of COLMAP to change for a second try, empty where there is to be none.

    There is one where the largest model has `registered` of `images` photographs, and these are fewer than three, or
    less than half of those that verified matches join: a model of half of them began well, and lacks overlap. There is
    none for the global mapper, which begins with no pair; where most pairs only turned on the spot, which no option
    turns into depth; and where the user set all of these options himself.
    """
    changes = {name: value for name, value in EASIER.items() if name not in _given(options.colmap)}
    if options.mapper == "global" or not changes or not _are_few(registered, images):
        return {}
    least = options.colmap.get("min_num_matches", _LEAST_MATCHES)
    joined = joined_by_matches(database, least, options.colmap.get("image_names") or None)
    if not _are_few(registered, joined):
        return {}
    motions = motions_of(database)
    return {} if sum(motion.only_turned for motion in motions) > len(motions) / 2 else changes


def _are_few(registered: int, images: int) -> bool:
    return registered < images and (registered < _FEW or registered < images / 2)


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a user set of the incremental mapper, by either way that the hierarchical one takes it."""
    of_parts = values.get("incremental_options") or {}
    return {**(values.get("mapper") or {}), **(of_parts.get("mapper") or {})}


def with_changes(options: SparseOptions, changes: Mapping[str, float]) -> SparseOptions:
    """Return the options with `changes` to COLMAP's incremental mapper, beside what the user set there."""
    mapper = {**changes, **(options.colmap.get("mapper") or {})}
    return options.model_copy(update={"colmap": {**options.colmap, "mapper": mapper}})
