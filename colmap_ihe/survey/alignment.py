"""Find how a model lies in the frame of its survey: by control points, scale bars, camera positions or GPS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from colmap_ihe.colmap.measures import upright
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.control import CameraPosition, ScaleBar, SurveyedPoint
from colmap_ihe.survey.frames import GPS, Frame, frame_of
from colmap_ihe.survey.observations import F64, LocatedPoint
from colmap_ihe.survey.similarity import USUAL_LENGTH, Fitted, Similarity, fitted

POINTS, BARS, POSITIONS, FIXES = "control_points", "scale_bars", "positions", "gps"
METHODS = (POINTS, BARS, POSITIONS, FIXES)
IN_WORDS = {POINTS: "control points", BARS: "scale bars", POSITIONS: "camera positions", FIXES: "GPS"}
_Y_UP_TO_Z_UP = np.array([(1.0, 0, 0), (0, 0, -1.0), (0, 1.0, 0)])
_DISAGREE = 4.0  # deviations by which bars may disagree
_BENT = 0.0025  # of a length: by so much a model that is not yet adjusted may well be bent


@dataclass(frozen=True)
class Survey:
    """Hold all that a survey says of one model: surveyed `points` by name, those of them that were `located` in it,
    `bars`, `positions`, and `fixes` of GPS by image (longitude, latitude, height) with their accuracy."""

    points: Mapping[str, SurveyedPoint] = field(default_factory=dict)
    located: Mapping[str, LocatedPoint] = field(default_factory=dict)
    bars: Sequence[ScaleBar] = ()
    positions: Sequence[CameraPosition] = ()
    fixes: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    fix_accuracy_m: float = 5.0
    crs: str = ""


@dataclass(frozen=True)
class Aligned:
    """Hold the frame, the similarity into it, and what does not fit: `left_out` names of points, bars and images with
    the reasons. `failure`: why there is none."""

    method: str
    frame: Frame = field(default_factory=Frame)
    similarity: Similarity | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    failure: str = ""


def align(model: pycolmap.Reconstruction, survey: Survey, method: str) -> Aligned:
    """Return how the model lies in the frame of the survey by one method. Raises what `frame_of` raises."""
    if method == POINTS:
        return _by_points(model, survey)
    find = {BARS: _by_bars, POSITIONS: _by_positions, FIXES: _by_fixes}[method]
    return find(model, survey)


def centres_of(model: pycolmap.Reconstruction) -> dict[str, F64]:
    """Return where the cameras of registered images stand (3,), by image name."""
    images = [model.images[i] for i in sorted(model.reg_image_ids())]
    return {str(image.name): np.asarray(image.projection_center()) for image in images}


def _frame(survey: Survey) -> Frame:
    return frame_of(
        survey.crs, [*(p.xyz for p in survey.points.values()), *(p.xyz for p in survey.positions)]
    )


def _by_points(model: pycolmap.Reconstruction, survey: Survey) -> Aligned:
    names = sorted(n for n, p in survey.points.items() if p.role == "control" and n in survey.located)
    frame = _frame(survey)
    if not names:
        return Aligned(POINTS, frame, failure="photographs show none of them")
    there = np.array([survey.located[name].xyz for name in names])
    surveyed = frame.to_model(np.array([survey.points[name].xyz for name in names]))
    accuracy = np.array([survey.points[name].accuracy_m for name in names])
    fit = fitted(there, surveyed, accuracy, bent_m=_BENT * _reach(surveyed))
    if fit.similarity is None:
        return Aligned(POINTS, frame, failure=fit.failure)
    out = _misfits(names, there, surveyed, fit) | _far_positions(model, survey, frame, fit.similarity)
    return Aligned(POINTS, frame, fit.similarity, out)


def _reach(points: F64) -> float:
    """Return about the extent of points (N, 3) in metres, whatever a few wrong ones say."""
    return 2 * float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _far_positions(
    model: pycolmap.Reconstruction, survey: Survey, frame: Frame, similarity: Similarity
) -> dict[str, str]:
    """Return the camera positions that are off by more than the others, with the reasons."""
    centres = centres_of(model)
    usable = [position for position in survey.positions if position.image in centres]
    if not usable:
        return {}
    stood = frame.to_model(np.array([position.xyz for position in usable]))
    away = np.linalg.norm(similarity(np.array([centres[p.image] for p in usable])) - stood, axis=1)
    off = away / np.array([position.accuracy_m for position in usable])
    limit = _DISAGREE * max(1.0, float(np.median(off)) / USUAL_LENGTH)
    return {
        position.image: f"{_length(float(metres))} from where control points put it"
        for position, metres, times in zip(usable, away, off, strict=True)
        if times > limit
    }


def _misfits(names: Sequence[str], there: F64, surveyed: F64, fit: Fitted) -> dict[str, str]:
    """Return why points do not fit, and whether two of them would with their names exchanged."""
    assert fit.similarity is not None
    off = {name: float(d) for name, d, fits in zip(names, fit.distances, fit.fits, strict=True) if not fits}
    moved, limit = fit.similarity(there), float(fit.distances[fit.fits].max())
    reasons = {name: f"{_length(d)} from where the others put it" for name, d in off.items()}
    for one, other in combinations(off, 2):
        a, b = names.index(one), names.index(other)
        apart = max(np.linalg.norm(moved[a] - surveyed[b]), np.linalg.norm(moved[b] - surveyed[a]))
        if apart <= max(2 * limit, 0.1 * min(off[one], off[other])):
            reasons[one] = reasons[other] = f"the names of {one} and {other} look exchanged"
    return reasons


def _length(metres: float) -> str:
    return f"{metres:.2f} m" if metres >= 1 else f"{1000 * metres:.0f} mm"


def _by_bars(model: pycolmap.Reconstruction, survey: Survey) -> Aligned:
    bars = [bar for bar in survey.bars if bar.first in survey.located and bar.second in survey.located]
    if not bars:
        return Aligned(BARS, failure="photographs show both ends of none of them")
    ratios = np.array([bar.length_m / _apart(survey, bar) for bar in bars])
    accuracy = np.array([bar.accuracy_m / bar.length_m for bar in bars])
    relative = np.hypot(accuracy, _BENT)
    middle = float(np.median(ratios))
    off = np.abs(ratios / middle - 1) / relative
    usual = max(1.0, float(np.median(off)) / 0.6745) if len(bars) > 2 else 1.0
    fits = off <= _DISAGREE * usual if len(bars) > 2 else np.ones(len(bars), bool)
    reasons = {
        bar.name: f"{100 * (ratio / middle - 1):+.2f} % beside the others"
        for bar, ratio, agrees in zip(bars, ratios, fits, strict=True)
        if not agrees
    }
    if len(bars) == 2 and abs(ratios[0] / ratios[1] - 1) > _DISAGREE * float(np.hypot(*relative)):
        apart = 100 * abs(ratios[0] / ratios[1] - 1)
        return Aligned(
            BARS,
            failure=f"{bars[0].name} and {bars[1].name} disagree by {apart:.1f} %, and no third one tells",
        )
    weights = accuracy[fits] ** -2.0
    return Aligned(BARS, Frame(), _upright(model, float(weights @ ratios[fits] / weights.sum())), reasons)


def _apart(survey: Survey, bar: ScaleBar) -> float:
    return float(np.linalg.norm(survey.located[bar.first].xyz - survey.located[bar.second].xyz))


def _upright(model: pycolmap.Reconstruction, scale: float) -> Similarity:
    """Return the similarity that makes the model so large, z up as the photographs were held, its middle the origin."""
    poses = [np.asarray(model.images[i].cam_from_world().matrix()) for i in model.reg_image_ids()]
    rotation = _Y_UP_TO_Z_UP @ upright(poses)
    points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
    middle = np.median(points, axis=0) if len(points) else np.zeros(3)
    return Similarity(scale, rotation, -scale * rotation @ middle)


def _by_positions(model: pycolmap.Reconstruction, survey: Survey) -> Aligned:
    centres = centres_of(model)
    usable = [position for position in survey.positions if position.image in centres]
    frame = _frame(survey)
    if not usable:
        return Aligned(POSITIONS, frame, failure="none of their photographs is registered")
    stood = frame.to_model(np.array([position.xyz for position in usable]))
    accuracy = np.array([position.accuracy_m for position in usable])
    names = [position.image for position in usable]
    return _by_cameras(model, centres, frame, names, stood, accuracy, POSITIONS)


def _by_fixes(model: pycolmap.Reconstruction, survey: Survey) -> Aligned:
    centres = centres_of(model)
    names = sorted(name for name in survey.fixes if name in centres)
    if not names:
        return Aligned(FIXES, failure="no registered photograph has a fix of its own")
    frame = frame_of(GPS, [survey.fixes[name] for name in names])
    stood = frame.to_model(np.array([survey.fixes[name] for name in names]))
    spread = float(np.sqrt(np.mean(np.sum((stood - stood.mean(axis=0))[:, :2] ** 2, axis=1))))
    if spread * np.sqrt(len(names)) < survey.fix_accuracy_m:
        return Aligned(
            FIXES,
            failure=f"the cameras stood within {spread:.1f} m, which fixes to {survey.fix_accuracy_m:g} m do not"
            " measure",
        )
    accuracy = np.full(len(names), survey.fix_accuracy_m)
    return _by_cameras(model, centres, frame, names, stood, accuracy, FIXES)


def _by_cameras(
    model: pycolmap.Reconstruction,
    centres: Mapping[str, F64],
    frame: Frame,
    names: Sequence[str],
    stood: F64,
    accuracy: F64,
    method: str,
) -> Aligned:
    poses = [np.asarray(model.images[i].cam_from_world().matrix()) for i in model.reg_image_ids()]
    up = upright(poses)[1]
    fit = fitted(np.array([centres[name] for name in names]), stood, accuracy, up)
    if fit.similarity is None:
        return Aligned(method, frame, failure=fit.failure)
    out = {
        name: f"{_length(float(d))} from where the others put it"
        for name, d, fits in zip(names, fit.distances, fit.fits, strict=True)
        if not fits
    }
    return Aligned(method, frame, fit.similarity, out)


def possible_methods(survey: Survey) -> list[str]:
    """Return the methods for which there is anything, in the order of `auto`."""
    there = {
        POINTS: any(point.role == "control" for point in survey.points.values()),
        BARS: bool(survey.bars),
        POSITIONS: bool(survey.positions),
        FIXES: bool(survey.fixes),
    }
    return [method for method in METHODS if there[method]]


def failure_in_words(aligned: Aligned) -> str:
    """Return the sentence for a method that gave nothing."""
    what = IN_WORDS[aligned.method]
    return f"the {what} cannot place the model: {aligned.failure}"


def left_out_in_words(aligned: Aligned) -> list[str]:
    """Return a sentence for what does not fit."""
    what = IN_WORDS[aligned.method]
    return [f"{what}: {name} is left out, {reason}" for name, reason in aligned.left_out.items()]
