"""Locate named points in a model from where photographs show them, and leave out what disagrees.

Each pair of photographs says where the point may lie; the place on which most photographs agree counts, refined by all
of them. How well photographs agree in this model is measured over all points together: a sight is left out where it is
off by several times of that, so one limit holds for a coarse model and for a fine one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.observations import F64, LocatedPoint, Observation
from colmap_ihe.survey.views import View, view_of

MIN_ANGLE_DEG = 1.5
"""Angle between two rays from which on a point counts as located: COLMAP's own limit."""

_TRIAL_PX, _TRIAL_ACCURACIES = 8.0, 8.0  # how far off a photograph may be that supports a trial
_FLOOR_PX, _TIMES = 1.0, 4.5  # least limit for a sight, and how many times of what is usual in the model
_RAYLEIGH_MEDIAN = 1.1774  # median length of a vector of two normal values of deviation 1
_MOST_PAIRS = 400
_STEPS = 10
_ROUNDS = 2  # the first is disturbed by what it leaves out


@dataclass(frozen=True)
class Triangulation:
    """Hold the points that could be located, by name, and of the others the reason."""

    points: dict[str, LocatedPoint]
    not_located: dict[str, str]


@dataclass
class _Trial:
    """Hold what is known so far of one point: its `usable` views, those of them that are `used`, and the reasons by
    image why others are `unusable` or `off`."""

    usable: list[View] = field(default_factory=list)
    unusable: dict[str, str] = field(default_factory=dict)
    used: list[View] = field(default_factory=list)
    off: dict[str, str] = field(default_factory=dict)
    xyz: F64 = field(default_factory=lambda: np.full(3, np.nan))
    failure: str = ""


def triangulate(
    reconstruction: pycolmap.Reconstruction, observations: Sequence[Observation]
) -> dict[str, LocatedPoint]:
    """Return the points that could be located, by name, in the frame of the model; `triangulation` tells of the
    others."""
    return triangulation(reconstruction, observations).points


def triangulation(
    reconstruction: pycolmap.Reconstruction, observations: Sequence[Observation]
) -> Triangulation:
    """Locate each name that at least two registered photographs see, by rays that meet at `MIN_ANGLE_DEG` or more.

    More than half of the photographs must agree on a place. A point that one photograph has twice is left out there.
    """
    by_name: dict[str, list[Observation]] = {}
    for observation in observations:
        by_name.setdefault(observation.name, []).append(observation)
    trials = {name: _trial(reconstruction, sights) for name, sights in by_name.items()}
    scale = 1.0
    for _ in range(_ROUNDS):
        whole = [trial for trial in trials.values() if not trial.failure]
        scale = _usual_scale(whole)
        for trial in whole:
            _settle(trial, scale)
    return Triangulation(
        {name: _located(trial, scale) for name, trial in trials.items() if not trial.failure},
        {name: trial.failure for name, trial in trials.items() if trial.failure},
    )


def _trial(model: pycolmap.Reconstruction, sights: Sequence[Observation]) -> _Trial:
    trial = _Trial()
    counts: dict[str, int] = {}
    for sight in sights:
        counts[sight.image] = counts.get(sight.image, 0) + 1
    for sight in sights:
        view = view_of(model, sight)
        if counts[sight.image] > 1:
            trial.unusable[sight.image] = f"seen {counts[sight.image]} times in this photograph"
        elif view is None:
            trial.unusable[sight.image] = "this photograph is not in the model"
        elif view.ray() is None:
            trial.unusable[sight.image] = "the lens of this photograph sees nothing there"
        else:
            trial.usable.append(view)
    _agree(trial)
    return trial


def _agree(trial: _Trial) -> None:
    """Find the place on which most views agree, or say in `failure` why there is none."""
    views = trial.usable
    if len(views) < 2:
        seen = f"only {views[0].image} sees it" if views else "no photograph of the model sees it"
        trial.failure = f"{seen}; a point needs two photographs"
        return
    trials = _meeting_points(views)
    if not len(trials):
        trial.failure = f"the rays of all photographs that see it meet at less than {MIN_ANGLE_DEG:g} degrees"
        return
    limits = np.array([max(_TRIAL_PX, _TRIAL_ACCURACIES * view.accuracy_px) for view in views])
    off = np.stack([np.linalg.norm(view.residuals(trials), axis=1) for view in views], axis=1) / limits
    costs = np.minimum(off**2, 1).sum(axis=1)
    best = int(np.argmin(costs))
    agreeing = off[best] < 1
    trial.failure = _disagreement(views, off, best, limits)
    if not trial.failure:
        trial.used = [view for view, agrees in zip(views, agreeing, strict=True) if agrees]
        trial.xyz = _refined(trials[best], trial.used)


def _meeting_points(views: Sequence[View]) -> F64:
    """Return (N, 3): where the rays of pairs of views come nearest, of those that meet at a sufficient angle; of many
    pairs those that meet most squarely."""
    rays = [view.ray() for view in views]
    found = []
    for (one, first), (other, second) in combinations(zip(views, rays, strict=True), 2):
        assert first is not None
        assert second is not None
        cosine = float(np.clip(first @ second, -1, 1))
        angle = np.degrees(np.arccos(cosine))
        if MIN_ANGLE_DEG <= angle <= 180 - MIN_ANGLE_DEG:
            along = _nearest(one.centre, first, other.centre, second)
            found.append((abs(cosine), along))
    found.sort(key=lambda pair: pair[0])
    return np.array([point for _, point in found[:_MOST_PAIRS]]).reshape(-1, 3)


def _nearest(start: F64, direction: F64, other_start: F64, other_direction: F64) -> F64:
    """Return (3,): the middle of the shortest line between two rays that are not parallel."""
    both = np.stack((direction, -other_direction), axis=1)
    (along, other_along), *_ = np.linalg.lstsq(both, other_start - start, rcond=None)
    return np.asarray((start + along * direction + other_start + other_along * other_direction) / 2)


def _disagreement(views: Sequence[View], off: F64, best: int, limits: F64) -> str:
    """Say why the views do not agree on the place of trial `best`; empty if more than half do, and on no other place.
    `off` is (trials, views), in units of `limits`."""
    agreeing = off < 1
    count = int(agreeing[best].sum())
    names = ", ".join(view.image for view in views[:4]) + (" ..." if len(views) > 4 else "")
    if len(views) == 2 and count < 2:
        apart = float(np.max(off[best] * limits))
        return f"{names} disagree by {apart:.1f} px, and no third photograph says which is right"
    if count < 2 or count <= len(views) / 2:
        return f"only {count} of the {len(views)} photographs that see it agree on a place ({names})"
    rivals = (agreeing.sum(axis=1) == count) & (agreeing != agreeing[best]).any(axis=1)
    if count == 2 and rivals.any():
        return f"of {names} several pairs agree, each on another place: one more photograph would tell"
    return ""


def _refined(start: F64, views: Sequence[View]) -> F64:
    """Return (3,): the point with the least squares of weighted residuals, by Gauss-Newton from `start`."""
    point, cost = start, _cost(start, views)
    for _ in range(_STEPS):
        matrix, vector = _normal_equations(point, views)
        step = -np.linalg.lstsq(matrix, vector, rcond=None)[0]
        moved = point + step
        moved_cost = _cost(moved, views)
        if not moved_cost < cost:
            break
        gain, point, cost = cost - moved_cost, moved, moved_cost
        if gain <= 1e-12 * cost:
            break
    return point


def _cost(point: F64, views: Sequence[View]) -> float:
    return float(sum(((view.residuals(point[None])[0] / view.accuracy_px) ** 2).sum() for view in views))


def _normal_equations(point: F64, views: Sequence[View]) -> tuple[F64, F64]:
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    for view in views:
        slope = view.derivatives(point) / view.accuracy_px
        matrix += slope.T @ slope
        vector += slope.T @ view.residuals(point[None])[0] / view.accuracy_px
    return matrix, vector


def _usual_scale(trials: Sequence[_Trial]) -> float:
    """Return the usual residual over its accuracy, as a standard deviation, robustly and of all points; at least 1:
    what is given as accuracy is not made better."""
    lengths = []
    for trial in trials:
        free = (2 * len(trial.used) - 3) / (2 * len(trial.used))  # what is left of residuals after the fit
        for view in trial.used:
            length = np.linalg.norm(view.residuals(trial.xyz[None])[0])
            lengths.append(float(length) / view.accuracy_px / np.sqrt(free))
    return max(1.0, float(np.median(lengths)) / _RAYLEIGH_MEDIAN) if lengths else 1.0


def _settle(trial: _Trial, scale: float) -> None:
    """Leave out one by one, the worst first, the views that are off by more than is usual, and take in those that are
    not; the point follows."""
    for _ in range(2 * len(trial.usable)):
        ratios = [_ratio(view, trial.xyz, scale) for view in trial.usable]
        agreeing = [view for view, ratio in zip(trial.usable, ratios, strict=True) if ratio <= 1]
        used = [ratio for view, ratio in zip(trial.usable, ratios, strict=True) if view in trial.used]
        if len(trial.used) > 2 and max(used) > 1:
            worst = trial.usable[ratios.index(max(used))]
            trial.used = [view for view in trial.used if view is not worst]
        elif len(agreeing) > len(trial.used):
            trial.used = agreeing
        else:
            break
        trial.xyz = _refined(trial.xyz, trial.used)
    _judge(trial, scale)


def _ratio(view: View, xyz: F64, scale: float) -> float:
    """Return how far off a view is, in units of its limit."""
    return float(np.linalg.norm(view.residuals(xyz[None])[0])) / _limit(view, scale)


def _limit(view: View, scale: float) -> float:
    return max(_FLOOR_PX, _TIMES * scale * view.accuracy_px)


def _judge(trial: _Trial, scale: float) -> None:
    trial.off = {}
    for view in trial.usable:
        if view not in trial.used:
            off = float(np.linalg.norm(view.residuals(trial.xyz[None])[0]))
            away = f"{off:.1f} px off" if np.isfinite(off) else "behind the camera"
            trial.off[view.image] = f"{away}, where {_limit(view, scale):.1f} px is the limit"
    count = len(trial.used)
    if count <= len(trial.usable) / 2 or any(_ratio(view, trial.xyz, scale) > 1 for view in trial.used):
        trial.failure = f"the {len(trial.usable)} photographs that see it do not agree on a place"
    elif not len(_meeting_points(trial.used)):
        trial.failure = f"the rays of the photographs that agree meet at less than {MIN_ANGLE_DEG:g} degrees"


def _located(trial: _Trial, scale: float) -> LocatedPoint:
    matrix, _ = _normal_equations(trial.xyz, trial.used)
    residuals = {view.image: view.residuals(trial.xyz[None])[0] for view in trial.usable}
    return LocatedPoint(
        xyz=trial.xyz,
        covariance=np.asarray(np.linalg.inv(matrix) * scale**2),
        residuals_px={image: (float(dx), float(dy)) for image, (dx, dy) in residuals.items()},
        pixels={view.image: (float(view.seen_px[0]), float(view.seen_px[1])) for view in trial.usable},
        accuracies={view.image: view.accuracy_px for view in trial.usable},
        used=tuple(view.image for view in trial.used),
        left_out=trial.unusable | trial.off,
    )
