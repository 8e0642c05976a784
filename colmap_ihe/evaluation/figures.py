"""Measure one method: its matches by pairs and movements, and its cameras against a truth."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.measures import poses_of, putative_and_inliers
from colmap_ihe.evaluation import pair_errors
from colmap_ihe.evaluation.pair_errors import MOVEMENTS, PairMatches
from colmap_ihe.evaluation.truth import Truth, key_of, pose_errors, read_truth
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.project.folder import Project

_AUC_DEG = 5.0


def truth_of(project: Project) -> Truth | None:
    """Read PROJECT/truth, or `gt` beside the photographs; None without. Raises `ProjectError`."""
    for folder in (project.root / "truth", project.images / "gt"):
        if folder.is_dir():
            return read_truth(folder)
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
