"""Judge a model from its figures: how good it is, in a paragraph of plain words, and what would make it better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from colmap_ihe.colmap.checks.overlap import ENOUGH, WIDE_DEG
from colmap_ihe.machine.words import counted, listed
from colmap_ihe.report.survey_contents import Verdict

Level = Literal["good", "fair", "poor"]
_LEVELS: tuple[Level, ...] = ("good", "fair", "poor")
_HEADLINES: dict[Level, str] = {
    "good": "This is a good model.",
    "fair": "This model is usable, with care.",
    "poor": "This model is weak: do not rely on what is measured in it.",
}

_ERROR_PX = (1.0, 2.0)
"""Mean reprojection error, from which on a model is fair and poor: features are placed to some 0.3 to 0.6 px, and
more than twice that is blur, movement, or a lens that the camera model does not fit."""
_FEATURES_SIDE = (
    3200  # pixels: larger photographs are searched at this size, and an error there is so much larger
)
_MISSING = (0.0, 0.1)
"""Share of the photographs that are not registered: one is a gap to look at, a tenth is a part of the object."""
_FEW = (0.1, 0.3)
"""Share of places that two photographs see. The edge of any set is so, some 3 to 7 % of the sound ones."""
_NARROW = (0.1, 0.3)
_FOCAL = (0.0005, 0.002)
"""Standard deviation of the focal length, as a share of it, which is the error of depths: 5 and 20 mm in 10 m."""
_CHECK_GSD = (3.0, 6.0)
"""Times what a pixel shows: RMS of check points. Well-surveyed blocks reach 1 across and 1.5 to 3 in depth."""
_MOST = 0.5  # share of places: of more it is the set as a whole that lacks photographs, and no part of it
_TOLD = 0.05  # share of places: fewer are the edges that every set has, and not worth a word


@dataclass(frozen=True)
class WeakPart:
    """Describe a part of the model, as "top left": so many `places` of it are too little seen, best by the photographs
    `beside`."""

    where: str
    places: int
    beside: Sequence[str]


@dataclass(frozen=True)
class ModelFigures:
    """Hold what a verdict is made from. `few` and `narrow`: shares of the places that fewer than three photographs see,
    or enough photographs from one side; None where there are no places; `few_parts` and `narrow_parts`: where most of
    them are. `gsd_mm`: what a pixel shows, None without metres. `doubts`: the number of warnings on the model."""

    few: float | None
    narrow: float | None
    few_parts: Sequence[WeakPart] = ()
    narrow_parts: Sequence[WeakPart] = ()
    gsd_mm: float | None = None
    doubts: int = 0


@dataclass(frozen=True)
class _Finding:
    """Hold a sentence on the model, with the level that it allows, and what to do."""

    level: Level
    sentence: str
    advice: str = ""


def verdict_of(summary: Mapping[str, Any], figures: ModelFigures) -> Verdict:
    """Return the verdict on a model; `summary` as report/summary.json has it. The worst finding decides."""
    found = [
        _registered(summary),
        _overlap(figures),
        _angles(figures),
        _error(summary),
        _calibration(summary["cameras"] or ()),
        _accuracy(summary, figures),
        _doubts(figures),
    ]
    findings = sorted(
        (finding for finding in found if finding is not None), key=lambda f: -_LEVELS.index(f.level)
    )
    level = findings[0].level
    return Verdict(
        level,
        _HEADLINES[level],
        " ".join(finding.sentence for finding in findings),
        [finding.advice for finding in findings if finding.advice],
    )


def _level(value: float, limits: tuple[float, float]) -> Level:
    """Return "good" up to the first limit, "fair" up to the second, else "poor"."""
    return _LEVELS[sum(value > limit for limit in limits)]


def _registered(summary: Mapping[str, Any]) -> _Finding:
    given, registered = summary["images"], summary["registered_images"]
    missing = given - registered
    if not missing:
        return _Finding("good", "All photographs are registered.")
    names = summary["unregistered"] or sorted(summary["left_out"])
    return _Finding(
        _level(missing / given, _MISSING),
        f"{counted(missing, 'photograph')} {'is' if missing == 1 else 'are'} not in it.",
        f"take photographs between {listed(names)} and their neighbours, or see why they were left out",
    )


def _overlap(figures: ModelFigures) -> _Finding:
    if figures.few is None:
        return _Finding("poor", "It has too few points to say what its photographs overlap in.")
    level = _level(figures.few, _FEW)
    if figures.few > _MOST:
        said = (
            f"Most of it, {_percent(figures.few)} of its places, is seen by two photographs only,"
            " so nothing confirms its depths."
        )
    elif level != "good":
        said = (
            f"{_percent(figures.few)} of its places are seen by two photographs only, which nothing confirms."
        )
    else:
        said = f"{_percent(1 - figures.few)} of its places are seen by three photographs or more."
    advice = ""
    if figures.few > _MOST:
        advice = (
            "add photographs between and beside those that are there, until each place is on three or more"
        )
    elif figures.few > _TOLD:
        where = f", most at the {_parts(figures.few_parts)}" if figures.few_parts else ""
        advice = f"add photographs of the places that fewer than {_number(ENOUGH)} photographs see{where}"
    return _Finding(level, said, advice)


def _angles(figures: ModelFigures) -> _Finding | None:
    if figures.narrow is None or figures.narrow <= _TOLD:
        return None
    where = f", most at the {_parts(figures.narrow_parts)}" if figures.narrow_parts else ""
    return _Finding(
        _level(figures.narrow, _NARROW),
        f"{_percent(figures.narrow)} of its places are seen from about one side, at less than {WIDE_DEG:g}°: their"
        " depths are ten times as uncertain as their places across.",
        f"step farther sideways, by a tenth of the distance or more, where photographs are taken from one side{where}",
    )


def _error(summary: Mapping[str, Any]) -> _Finding:
    error = summary["mean_reprojection_error_px"]
    longest = max((max(c["width"], c["height"]) for c in summary["cameras"] or ()), default=0)
    larger = max(1.0, longest / _FEATURES_SIDE)
    level = _level(error / larger, _ERROR_PX)
    said = f"Its points are {error:.2f} px off in the mean"
    if level == "good":
        return _Finding(level, f"{said}, as sharp photographs give it.")
    return _Finding(
        level,
        f"{said}, more than features can be placed to.",
        "see that photographs are sharp, that nothing moved, and that zoom and focus were not changed",
    )


def _calibration(cameras: Sequence[Mapping[str, Any]]) -> _Finding | None:
    if any(camera["by"] == "colmap" for camera in cameras):
        return _Finding(
            "fair",
            "Nothing says how certain the focal length is, for it was not calibrated.",
            "take ten photographs or more with each camera, and leave sparse.calibration at auto",
        )
    shares = [share for camera in cameras if (share := _focal_deviation(camera)) is not None]
    if not shares:
        return None
    level, worst = _level(max(shares), _FOCAL), max(shares)
    how = "certain" if level == "good" else "certain only"
    said = f"The focal length is {how} to {100 * worst:.2g} %, {10_000 * worst:.2g} mm in a depth of 10 m."
    if level == "good":
        return _Finding(level, said)
    return _Finding(
        level,
        said,
        "take some photographs with the camera turned by 90°, and some from nearer and farther",
    )


def _focal_deviation(camera: Mapping[str, Any]) -> float | None:
    """Return the largest standard deviation of a focal length as a share of it, None where it is not known."""
    deviations = camera["standard_deviations"]
    names = [name for name in ("f", "fx", "fy") if deviations and deviations.get(name)]
    return max((deviations[name] / camera["parameters"][name] for name in names), default=None)


def _accuracy(summary: Mapping[str, Any], figures: ModelFigures) -> _Finding | None:
    if not summary["metric"]:
        return None
    rms = summary["check_rms_mm"]
    if rms is None or figures.gsd_mm is None:
        return _Finding(
            "good",
            "Nothing outside of it says how true its measures are, for it has no check point.",
            "survey a few points more, and give them the role check in control/points.csv",
        )
    times = rms / figures.gsd_mm
    level = _level(times, _CHECK_GSD)
    said = f"Its check points are off by {times:.2g} of what a pixel shows"
    if level == "good":
        return _Finding(level, f"{said}.")
    return _Finding(
        level, f"{said}, more than a sound survey gives.", "see the points with the largest errors"
    )


def _doubts(figures: ModelFigures) -> _Finding | None:
    if not figures.doubts:
        return None
    said = (
        "Of the warnings below one is"
        if figures.doubts == 1
        else f"Of the warnings below {figures.doubts} are"
    )
    return _Finding("fair", f"{said} on the model itself.")


def _parts(parts: Sequence[WeakPart]) -> str:
    return "; ".join(
        f"{part.where} ({counted(part.places, 'place')}, beside {' and '.join(part.beside)})"
        for part in parts
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _number(count: int) -> str:
    return ("no", "one", "two", "three", "four")[count]
