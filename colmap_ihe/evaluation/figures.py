"""Measure one method: its matches by pairs, those that the user chose or all, and its cameras against a truth."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.measures import poses_of, putative_and_inliers
from colmap_ihe.errors import OptionError
from colmap_ihe.evaluation import pair_errors
from colmap_ihe.evaluation.pair_errors import MOVEMENTS, PairMatches
from colmap_ihe.evaluation.truth import Truth, key_of, pose_errors, read_truth
from colmap_ihe.machine.files import read_at_most
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.project.folder import Project

_AUC_DEG = 5.0
_LINE_END = re.compile("\r\n|\r|\n")  # and not the separators of lines that a name may hold
_MOST_BYTES = 100_000_000  # of a list of pairs
_LONGEST = 10_000  # characters of a line: of names that a file can have, two are shorter


def truth_of(project: Project) -> Truth | None:
    """Read PROJECT/truth, or `gt` beside the photographs; None without. Raises `ProjectError`."""
    for folder in (project.root / "truth", project.images / "gt"):
        if folder.is_dir():
            return read_truth(folder)
    return None


def read_pairs(file: Path, names: Collection[str]) -> set[frozenset[str]]:
    """Return the pairs in `file`, two of `names` a line, which may hold spaces, as in COLMAP's lists of pairs. Empty
    lines and those that begin with # do not count. Raises `OptionError`, which names the line."""
    hint = "two names of photographs a line, as below images/, with a space between"
    try:
        lines = _LINE_END.split(read_at_most(file, _MOST_BYTES).decode("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise OptionError(f"{file}: cannot be read ({reason})", hint=hint) from error
    photographs = set(names)
    chosen = set()
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if text and not text.startswith("#"):
            pair = _pair(text, photographs) if len(text) <= _LONGEST else None
            if pair is None:
                raise OptionError(f"{file}: line {number}, {text!r:.80}, is not two photographs", hint=hint)
            chosen.add(pair)
    if not chosen:
        raise OptionError(f"{file}: names no pair", hint=hint)
    return chosen


def _pair(text: str, photographs: set[str]) -> frozenset[str] | None:
    for at, letter in enumerate(text):
        if letter.isspace():
            pair = frozenset((text[:at].strip(), text[at:].strip()))
            if len(pair) == 2 and pair <= photographs:
                return pair
    return None


def plain_truth(truth: Truth | None) -> list[Any] | None:
    """Return what figures against a truth depend on, as plain values."""
    if truth is None:
        return None
    images = sorted(truth.images.items())
    return [truth.extent_m, *((key, image.cam_from_world.tolist()) for key, image in images)]


def matching_of(
    project: Project, cameras: Path, chosen: Collection[frozenset[str]] | None
) -> dict[str, dict[str, float | None]]:
    """Count matches over all pairs, or those chosen, and by movement of the camera in the sparse model `cameras`."""
    poses = poses_of(cameras)
    record = read_record(project, "convert") or {}
    photographs = {grey: name for name, grey in record["grey"].items()}
    kinds: dict[str, list[PairMatches]] = {"all": [], **{name: [] for name in MOVEMENTS}}
    for (first, second), counts in putative_and_inliers(project.database).items():
        if chosen is not None and frozenset((photographs[first], photographs[second])) not in chosen:
            continue
        pair = PairMatches(*counts)
        kinds["all"].append(pair)
        if first in poses and second in poses and pair.inliers:
            kinds[pair_errors.movement(poses[first], poses[second])].append(pair)
    return {
        name: {
            "pairs": len(pairs),
            "putative": sum(p.putative for p in pairs),
            "inliers": sum(p.inliers for p in pairs),
            "efficiency_percent": pair_errors.efficiency_percent(pairs),
        }
        for name, pairs in kinds.items()
    }


def errors_against(truth: Truth, model: Path) -> dict[str, float]:
    """Return the errors of a sparse model's cameras: degrees, metres, and the area under the curve in percent."""
    poses = {key_of(name): pose for name, pose in poses_of(model).items()}
    errors = pose_errors(poses, truth)
    true = {key: image.cam_from_world for key, image in truth.images.items()}
    relative = pair_errors.relative_errors_deg(poses, true)
    return {
        "rotation_deg": errors.rotation_error_deg,
        "position_m": errors.position_error_m,
        "auc_percent": pair_errors.area_under_curve_percent(relative, _AUC_DEG),
    }
