"""Hold how well a model agrees with its survey, point by point, as surveyors tell it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey import alignment
from colmap_ihe.survey.alignment import Aligned, Survey, centres_of
from colmap_ihe.survey.frames import Frame
from colmap_ihe.survey.observations import F64
from colmap_ihe.survey.triangulate import Triangulation

Metres3 = tuple[float, float, float]


@dataclass(frozen=True)
class PointAccuracy:
    """Describe one named point. `role`: control, check, or `seen` for one without coordinates. `delta_m`: where the
    photographs show it less where it was surveyed, x y z; `deviation_m`: the standard deviations expected of that;
    `sights` photographs show it, `error_px` the root mean square of their residuals, along one axis, and
    `residuals_px` the lengths of these. `used`: whether it took part; `reason`: why not, or why there is no delta."""

    name: str
    role: str
    surveyed: Metres3 | None
    delta_m: Metres3 | None
    deviation_m: Metres3 | None
    sights: int
    error_px: float | None
    used: bool
    reason: str = ""
    residuals_px: tuple[float, ...] = ()


@dataclass(frozen=True)
class BarAccuracy:
    """Describe a scale bar: its measured length, and how much longer it is in the model (`delta_m`)."""

    name: str
    length_m: float
    delta_m: float | None
    used: bool
    reason: str = ""


@dataclass(frozen=True)
class PositionAccuracy:
    """Describe a camera position: where the model has the camera less where it was measured to stand."""

    image: str
    delta_m: Metres3 | None
    used: bool
    reason: str = ""


def rms(values: Sequence[Metres3 | float]) -> float | None:
    """Return the root mean square of lengths, or of numbers; None of none."""
    if not values:
        return None
    squares = [float(np.sum(np.square(value))) for value in values]
    return float(np.sqrt(np.mean(squares)))


def point_rms(points: Sequence[PointAccuracy], role: str) -> float | None:
    """Return the root mean square of the distances of all points of a role, in metres; of control points those that
    took part."""
    return rms([p.delta_m for p in points if p.role == role and p.delta_m and (p.used or role == "check")])


def points_of(
    survey: Survey,
    final: Triangulation,
    frame: Frame,
    out: Mapping[str, str],
    covariances: Mapping[str, F64],
) -> list[PointAccuracy]:
    """Return every point that is surveyed or seen, by name. `out`: what was left out, with reasons; `covariances`
    (3, 3) where the model was adjusted; else those of the sights alone."""
    results = []
    for name in sorted({*survey.points, *final.points, *final.not_located}):
        point, located = survey.points.get(name), final.points.get(name)
        delta = deviation = None
        if point and located is not None:
            surveyed = frame.to_model(np.array([point.xyz]))[0]
            delta = _three(located.xyz - surveyed)
            spread = covariances.get(name, located.covariance)
            deviation = _three(np.sqrt(np.maximum(np.diag(spread), 0) + point.accuracy_m**2))
        reason = out.get(name) or final.not_located.get(name) or ("" if located else "no photograph shows it")
        residuals = [located.residuals_px[image] for image in located.used] if located else []
        results.append(
            PointAccuracy(
                name,
                point.role if point else "seen",
                point.xyz if point else None,
                delta,
                deviation,
                len(residuals),
                float(np.sqrt(np.mean(np.sum(np.square(residuals), axis=1)) / 2)) if residuals else None,
                bool(point and point.role == "control" and located is not None and name not in out),
                reason,
                tuple(float(np.hypot(*residual)) for residual in residuals),
            )
        )
    return results


def _three(values: F64) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def bars_of(survey: Survey, final: Triangulation, out: Mapping[str, str]) -> list[BarAccuracy]:
    """Return every scale bar, in the order of the survey."""
    results = []
    for bar in survey.bars:
        missing = [end for end in (bar.first, bar.second) if end not in final.points]
        delta = None
        if not missing:
            apart = final.points[bar.first].xyz - final.points[bar.second].xyz
            delta = float(np.linalg.norm(apart)) - bar.length_m
        reason = out.get(bar.name) or (f"{' and '.join(missing)} not located" if missing else "")
        results.append(BarAccuracy(bar.name, bar.length_m, delta, not reason, reason))
    return results


def positions_of(
    model: pycolmap.Reconstruction, survey: Survey, aligned: Aligned, out: Mapping[str, str]
) -> list[PositionAccuracy]:
    """Return every camera position, or fix of GPS where the model was aligned by these."""
    centres, results = centres_of(model), []
    places = {position.image: position.xyz for position in survey.positions}
    if aligned.method == alignment.FIXES:
        places = dict(survey.fixes)
    for image, xyz in places.items():
        delta = None
        if image in centres:
            delta = _three(centres[image] - aligned.frame.to_model(np.array([xyz]))[0])
        reason = out.get(image) or ("" if delta else "it is not registered")
        results.append(PositionAccuracy(image, delta, not reason, reason))
    return results
