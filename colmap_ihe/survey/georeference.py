"""Put a model into metres: align it with its survey, adjust it with control, and tell how well it agrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import ControlFileError
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.survey import alignment
from colmap_ihe.survey.accuracy import (
    BarAccuracy,
    PointAccuracy,
    PositionAccuracy,
    bars_of,
    points_of,
    positions_of,
)
from colmap_ihe.survey.adjustment import MOST_IMAGES, adjust_with_control
from colmap_ihe.survey.alignment import Aligned, Survey
from colmap_ihe.survey.control_equations import ControlTerms
from colmap_ihe.survey.control_fit import ControlFit
from colmap_ihe.survey.frames import Frame
from colmap_ihe.survey.observations import F64, LocatedPoint, Observation
from colmap_ihe.survey.spread import Spread
from colmap_ihe.survey.triangulate import Triangulation, triangulation

_ROUNDS = 4
_OWN_SHARE = 0.5  # of a tie point's deviation: a lens that is not quite known is off for targets too


@dataclass(frozen=True)
class Georeferenced:
    """Hold what came of it: the `method`, empty for none, the frame, the similarity (3, 4) that the model was moved by
    before it was adjusted, whether it was `adjusted`, its agreement with the survey, sentences for the user, and the
    standard deviations of the parameters of each camera that was adjusted, by its id."""

    method: str = ""
    frame: Frame = field(default_factory=Frame)
    similarity: F64 | None = None
    adjusted: bool = False
    points: Sequence[PointAccuracy] = ()
    bars: Sequence[BarAccuracy] = ()
    positions: Sequence[PositionAccuracy] = ()
    triangulated: Triangulation | None = None
    warnings: Sequence[str] = ()
    camera_deviations: Mapping[int, Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Adjusted:
    """Hold the named points that took part, in their order, how well all is known then, the point that is still wrong,
    with how far it is off, and what else the user should doubt."""

    names: Sequence[str]
    spread: Spread
    wrong: tuple[str, str] | None = None
    doubt: str = ""


def georeference(
    model: pycolmap.Reconstruction,
    survey: Survey,
    observations: Sequence[Observation],
    align: str,
    free_params: Mapping[int, Sequence[int]],
    progress: Progress = SILENT,
) -> Georeferenced:
    """Move a model into the frame of its survey and adjust it with control, in place; nothing changes where no method
    applies. `align`: a method of `alignment.METHODS`, or "auto" for the first that works. Raises `ControlFileError`
    where the one that was asked for does not, what `frame_of` raises, and `Cancelled`."""
    located = triangulation(model, observations)
    survey = replace(survey, located=located.points)
    aligned, warnings = _aligned(model, survey, align)
    if aligned is None or aligned.similarity is None:
        return Georeferenced(triangulated=located, warnings=warnings)
    survey = _in_its_frame(survey, aligned.method)
    model.transform(pycolmap.Sim3d(aligned.similarity.matrix()))
    warnings += alignment.left_out_in_words(aligned)
    out = dict(aligned.left_out)
    adjusted = None
    if aligned.method != alignment.FIXES:
        adjusted, told = _adjusted_and_told(
            model, survey, observations, aligned.frame, out, free_params, progress
        )
        warnings += told
    final = triangulation(model, observations)
    covariances = _covariances(model, survey, final.points, aligned.frame, adjusted) if adjusted else {}
    return Georeferenced(
        aligned.method,
        aligned.frame,
        aligned.similarity.matrix(),
        adjusted is not None,
        points_of(survey, final, aligned.frame, out, covariances),
        bars_of(survey, final, out),
        positions_of(model, survey, aligned, out),
        final,
        warnings,
        _camera_deviations(model, adjusted.spread) if adjusted else {},
    )


def _in_its_frame(survey: Survey, method: str) -> Survey:
    """Return the survey without coordinates that are of another frame than the model: those of files, where scale bars
    or GPS made it."""
    if method in (alignment.BARS, alignment.FIXES):
        return replace(survey, points={}, positions=())
    return survey


def _aligned(model: pycolmap.Reconstruction, survey: Survey, align: str) -> tuple[Aligned | None, list[str]]:
    """Return the alignment of the first method that works, and why others do not."""
    methods = alignment.possible_methods(survey) if align == "auto" else [align]
    warnings: list[str] = []
    for method in methods:
        aligned = alignment.align(model, survey, method)
        if aligned.similarity is not None:
            return aligned, warnings
        if align != "auto":
            raise ControlFileError(
                f"survey.align is {align}, and {alignment.failure_in_words(aligned)}",
                hint="see docs/survey.md, or let survey.align be auto",
            )
        warnings.append(alignment.failure_in_words(aligned))
    return None, warnings


def _adjusted_and_told(
    model: pycolmap.Reconstruction,
    survey: Survey,
    observations: Sequence[Observation],
    frame: Frame,
    out: dict[str, str],
    free_params: Mapping[int, Sequence[int]],
    progress: Progress,
) -> tuple[_Adjusted | None, list[str]]:
    """Adjust as `_adjusted` does where that is possible, and say what does not fit or why it is not."""
    if model.num_reg_images() > MOST_IMAGES:
        return None, [
            f"the model has {model.num_reg_images()} photographs, more than the {MOST_IMAGES} that are adjusted"
            " with control: it is moved as a whole"
        ]
    before = set(out)
    adjusted, told = None, []
    try:
        adjusted = _adjusted(model, survey, observations, frame, out, free_params, progress)
    except np.linalg.LinAlgError:
        told = ["the adjustment with control has no solution: the model is left as it was before it"]
    told += [f"{name} is left out of the adjustment, {out[name]}" for name in out if name not in before]
    if adjusted and adjusted.wrong:
        name, away = adjusted.wrong
        told.append(
            f"{name} is {away} though {_ROUNDS - 1} points were left out of the adjustment: look at the survey's"
            " points and at where they were clicked"
        )
    elif adjusted and adjusted.doubt:
        told.append(adjusted.doubt)
    return adjusted, told


def _adjusted(
    model: pycolmap.Reconstruction,
    survey: Survey,
    observations: Sequence[Observation],
    frame: Frame,
    out: dict[str, str],
    free_params: Mapping[int, Sequence[int]],
    progress: Progress,
) -> _Adjusted | None:
    """Adjust with all control that fits, without what proves wrong then, worst first, which is added to `out`; None
    where there is nothing to adjust by."""
    progress.start(_ROUNDS, "adjustments with control")
    for left in reversed(range(_ROUNDS)):
        located = triangulation(model, observations).points
        names = sorted(name for name in located if _takes_part(name, survey, out))
        terms = _terms(model, survey, located, names, frame, out)
        if not (np.isfinite(terms.accuracy_m).any() or len(terms.lengths) or len(terms.at)):
            break
        adjusted = _Adjusted(names, adjust_with_control(model, terms, free_params, progress))
        progress.advance()
        fit = _fit(survey, triangulation(model, observations).points, frame, adjusted)
        wrong = fit.wrong()
        if wrong is None or not left:
            return replace(adjusted, wrong=wrong, doubt=fit.doubt())
        out[wrong[0]] = wrong[1]
    return None


def _covariances(
    model: pycolmap.Reconstruction,
    survey: Survey,
    located: Mapping[str, LocatedPoint],
    frame: Frame,
    adjusted: _Adjusted,
) -> dict[str, F64]:
    """Return the covariances (3, 3) of all named points that have a place, whether they took part or not."""
    apart = sorted(located.keys() - set(adjusted.names))
    terms = _terms(model, survey, located, apart, frame, {})
    covariances = [*adjusted.spread.of_points(), *adjusted.spread.of_points_apart(terms)]
    return dict(zip([*adjusted.names, *apart], covariances, strict=True))


def _camera_deviations(model: pycolmap.Reconstruction, spread: Spread) -> dict[int, Sequence[float]]:
    camera_ids = sorted({model.images[i].camera_id for i in model.reg_image_ids()})
    return dict(zip(camera_ids, spread.of_cameras(), strict=True))


def _takes_part(name: str, survey: Survey, out: Mapping[str, str]) -> bool:
    """Tell whether a point takes part: one without coordinates does as a tie point, a check point never."""
    point = survey.points.get(name)
    ends = {end for bar in survey.bars if bar.name not in out for end in (bar.first, bar.second)}
    if point is None:
        return name in ends
    return point.role == "control" and name not in out


def _terms(
    model: pycolmap.Reconstruction,
    survey: Survey,
    located: Mapping[str, LocatedPoint],
    names: Sequence[str],
    frame: Frame,
    out: Mapping[str, str],
) -> ControlTerms:
    images = {str(model.images[i].name): n for n, i in enumerate(sorted(model.reg_image_ids()))}
    number = {name: n for n, name in enumerate(names)}
    places = np.array([located[name].xyz for name in names]).reshape(-1, 3)
    surveyed, accuracy = np.zeros((len(names), 3)), np.full(len(names), np.inf)
    for name, n in number.items():
        if name in survey.points:
            surveyed[n] = frame.to_model(np.array([survey.points[name].xyz]))[0]
            accuracy[n] = survey.points[name].accuracy_m
    floor = _OWN_SHARE * _tie_deviation(model)
    sights = [
        (
            images[image],
            number[name],
            located[name].pixels[image],
            max(floor, located[name].accuracies[image]),
        )
        for name in names
        for image in located[name].used
    ]
    bars = [b for b in survey.bars if b.first in number and b.second in number and b.name not in out]
    stood = [p for p in survey.positions if p.image in images and p.image not in out]
    centres = np.array([position.xyz for position in stood]).reshape(-1, 3)
    return ControlTerms(
        located=places,
        surveyed=surveyed,
        accuracy_m=accuracy,
        image=np.array([image for image, *_ in sights], np.intp),
        point=np.array([point for _, point, *_ in sights], np.intp),
        pixels=np.array([pixel for _, _, pixel, _ in sights]).reshape(-1, 2),
        accuracy_px=np.array([deviation for *_, deviation in sights]),
        ends=np.array([(number[b.first], number[b.second]) for b in bars], np.intp).reshape(-1, 2),
        lengths=np.array([bar.length_m for bar in bars]),
        bar_accuracy_m=np.array([bar.accuracy_m for bar in bars]),
        at=np.array([images[position.image] for position in stood], np.intp),
        centres=frame.to_model(centres) if len(centres) else centres,
        centre_accuracy_m=np.array([position.accuracy_m for position in stood]),
    )


def _tie_deviation(model: pycolmap.Reconstruction) -> float:
    """Return about the standard deviation of a tie point's coordinate, in pixels."""
    return float(model.compute_mean_reprojection_error()) / 1.25


def _fit(
    survey: Survey, located: Mapping[str, LocatedPoint], frame: Frame, adjusted: _Adjusted
) -> ControlFit:
    """Return how the control points of an adjustment fit it."""
    names = adjusted.names
    used = [n for n, name in enumerate(names) if name in survey.points and name in located]
    surveyed = np.array([survey.points[names[n]].xyz for n in used]).reshape(-1, 3)
    places = np.array([located[names[n]].xyz for n in used]).reshape(-1, 3)
    return ControlFit(
        [names[n] for n in used],
        places - frame.to_model(surveyed),
        np.array([survey.points[names[n]].accuracy_m for n in used]),
        adjusted.spread.of_points()[used],
    )
