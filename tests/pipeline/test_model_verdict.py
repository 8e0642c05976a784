"""How good a model is said to be: made-up models, good and bad."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from walls import wall_places

from colmap_ihe.pipeline.model_verdict import ModelFigures, verdict_of
from colmap_ihe.pipeline.overlap_maps import FRONT, weak_parts

CAMERA = {
    "by": "calibration", "width": 1600, "height": 1200,
    "parameters": {"f": 1000.0, "cx": 800.0, "cy": 600.0}, "standard_deviations": {"f": 0.2, "cx": 0.0, "cy": 0.0},
}  # fmt: skip
SUMMARY: dict[str, Any] = {
    "images": 12, "registered_images": 12, "unregistered": [], "left_out": {}, "mean_reprojection_error_px": 0.4,
    "cameras": [CAMERA], "metric": False, "check_rms_mm": None,
}  # fmt: skip


def figures_of(across: list[float], reach: float, distance: float = 5.0) -> ModelFigures:
    places, centres = wall_places(across, reach, distance)
    names = [f"p{number}.jpg" for number in range(len(centres))]
    few, narrow = places.few, places.narrow
    return ModelFigures(
        float(few.mean()),
        float(narrow.mean()),
        weak_parts(places, few, [FRONT], names),
        weak_parts(places, narrow, [FRONT], names),
    )


def test_a_wall_that_many_photographs_see_is_a_good_model_and_asks_for_nothing() -> None:
    verdict = verdict_of(SUMMARY, figures_of(list(np.arange(-2, 15, 1.5)), reach=4))
    assert (verdict.level, verdict.headline) == ("good", "This is a good model.")
    assert verdict.paragraph.startswith(
        "All photographs are registered. 100 % of its places are seen by three"
    )
    assert "certain to 0.02 %, 2 mm in a depth of 10 m" in verdict.paragraph
    assert verdict.advice == []


def test_a_wall_in_overlaps_of_two_photographs_is_weak_and_told_so_first() -> None:
    verdict = verdict_of(SUMMARY, figures_of([2, 5, 8, 11], reach=2.9))
    assert verdict.level == "poor" and "do not rely" in verdict.headline
    assert verdict.paragraph.startswith("Most of it, 100 % of its places")
    assert "seen by two photographs only, so nothing confirms its depths" in verdict.paragraph
    assert verdict.advice == [
        "add photographs between and beside those that are there, until each place is on three or more"
    ]


def test_the_part_that_lacks_photographs_is_named_with_those_beside_it() -> None:
    verdict = verdict_of(SUMMARY, figures_of([0, 1.5, 3, 4.5, 6, 7.5], reach=4))
    assert verdict.level == "fair"
    assert "of its places are seen by two photographs only, which nothing confirms" in verdict.paragraph
    [advice] = verdict.advice
    assert "right" in advice and "left" not in advice and "beside p4.jpg and p5.jpg" in advice


def test_photographs_from_one_place_are_too_close_together() -> None:
    verdict = verdict_of(SUMMARY, figures_of([5.9, 6, 6.1], reach=20))
    assert verdict.level == "poor"
    assert verdict.paragraph.startswith("100 % of its places are seen from about one side, at less than 6°")
    assert verdict.advice[0].startswith("step farther sideways, by a tenth of the distance")


GOOD = ModelFigures(0.03, 0.0)


@pytest.mark.parametrize(
    ("change", "level", "words"),
    [
        ({"registered_images": 11, "unregistered": ["a.jpg"]}, "fair", "1 photograph is not in it"),
        ({"registered_images": 8, "unregistered": list("abcd")}, "poor", "4 photographs are not in it"),
        ({"mean_reprojection_error_px": 1.2}, "fair", "1.20 px off in the mean, more than features"),
        ({"mean_reprojection_error_px": 2.3}, "poor", "2.30 px off"),
        (
            {"mean_reprojection_error_px": 1.2, "cameras": [{**CAMERA, "width": 6400}]},
            "good",
            "as sharp photographs give it",
        ),
        (
            {"cameras": [{**CAMERA, "standard_deviations": {"f": 1.0}}]},
            "fair",
            "0.1 %, 10 mm in a depth of 10 m",
        ),
        ({"cameras": [{**CAMERA, "standard_deviations": {"f": 4.0}}]}, "poor", "0.4 %, 40 mm"),
        (
            {"cameras": [{**CAMERA, "by": "colmap", "standard_deviations": None}]},
            "fair",
            "how certain the focal length is",
        ),
    ],
)
def test_each_figure_has_its_limits(change: dict[str, Any], level: str, words: str) -> None:
    verdict = verdict_of({**SUMMARY, **change}, GOOD)
    assert verdict.level == level
    assert words in verdict.paragraph
    if level != "good":
        assert words in verdict.paragraph.partition(". ")[0] + "."  # the worst comes first
        assert verdict.advice


@pytest.mark.parametrize(("rms", "level"), [(5.0, "good"), (20.0, "fair"), (35.0, "poor")])
def test_check_points_are_judged_by_what_a_pixel_shows(rms: float, level: str) -> None:
    metric = {**SUMMARY, "metric": True, "check_rms_mm": rms}
    assert verdict_of(metric, ModelFigures(0.03, 0.0, gsd_mm=5.0)).level == level


def test_a_model_without_check_points_is_told_that_nothing_checks_it() -> None:
    verdict = verdict_of({**SUMMARY, "metric": True}, ModelFigures(0.03, 0.0, gsd_mm=5.0))
    assert "has no check point" in verdict.paragraph
    assert verdict.advice == ["survey a few points more, and give them the role check in control/points.csv"]


def test_doubts_of_the_model_are_no_praise() -> None:
    verdict = verdict_of(SUMMARY, ModelFigures(0.03, 0.0, doubts=1))
    assert verdict.level == "fair" and "one is on the model itself" in verdict.paragraph
    assert verdict_of(SUMMARY, ModelFigures(None, None)).level == "poor"
