"""What makes features stale: a lower threshold where features run out does, COLMAP's own given by the user does not."""

from __future__ import annotations

from typing import Any

import pytest

from colmap_ihe.colmap.lower_thresholds import COLMAPS_THRESHOLD
from colmap_ihe.pipeline.resource_needs import Known
from colmap_ihe.pipeline.stages.features import STAGE
from colmap_ihe.project.options import Options

OWN = {"peak_threshold": COLMAPS_THRESHOLD}


@pytest.mark.parametrize(
    ("colmap", "recorded", "lowest"),
    [
        ({}, {}, [0.5, 5]),
        ({"sift": {"first_octave": 0}}, {"sift": {"first_octave": 0}}, [0.5, 5]),
        ({"sift": OWN, "max_image_size": 900}, {"max_image_size": 900}, None),
        ({"sift": OWN | {"first_octave": 0}}, {"sift": {"first_octave": 0}}, None),
        ({"sift": {"peak_threshold": 0.004}}, {"sift": {"peak_threshold": 0.004}}, None),
    ],
)
def test_options_that_decide_features(
    colmap: dict[str, Any], recorded: dict[str, Any], lowest: list[float] | None
) -> None:
    values = STAGE.options_of(Options.model_validate({"features": {"colmap": colmap}}))
    assert values["features"]["colmap"] == recorded
    assert values.get("lowest_threshold") == lowest


@pytest.mark.parametrize(
    ("pixels", "colmap", "units"),
    [
        (400_000, {}, ["images", "images, lower threshold"]),
        (2_000_000, {}, ["images"]),
        (400_000, {"sift": OWN}, ["images"]),
    ],
)
def test_small_photographs_are_expected_to_take_two_extractions(
    pixels: int, colmap: dict[str, Any], units: list[str]
) -> None:
    options = Options.model_validate({"features": {"colmap": colmap}})
    known = Known(
        images=10, pixels=10 * pixels, raw_pixels=0, with_gps=0, features=0, inliers=0, registered=10
    )
    assert [part.unit for part in STAGE.parts(options, known)] == units


def test_large_photographs_are_expected_to_take_a_third_of_the_time() -> None:
    known = Known(
        images=10, pixels=60_000_000, raw_pixels=0, with_gps=0, features=0, inliers=0, registered=10
    )
    seconds = [
        STAGE.parts(Options.model_validate({"features": {"octaves": octaves}}), known)[0].seconds
        for octaves in ("auto", "colmap")
    ]
    assert seconds == pytest.approx([0.165 * 60 + 4, 0.55 * 60 + 4])
