"""The verdict over runs of two methods, and its standard error."""

from __future__ import annotations

import math

import numpy as np
import pytest

from colmap_ihe.evaluation.tables import LEFT_OUT, standard_error, verdict


def test_the_standard_error_is_that_of_all_from_runs_without_some() -> None:
    draw = np.random.default_rng(0)
    values = draw.normal(size=5000)
    means = [values[draw.random(5000) >= LEFT_OUT].mean() for _ in range(400)]
    assert standard_error(means) == pytest.approx(values.std() / 5000**0.5, rel=0.1)
    assert math.isnan(standard_error([1.0]))


@pytest.mark.parametrize(
    ("ours", "theirs", "more_is_better", "words"),
    [
        ([110, 110, 111, 109], [100, 100, 101, 99], True, "better"),
        ([0.5, 0.51, 0.5, 0.51], [0.6, 0.61, 0.6, 0.61], False, "better"),
        ([90, 90, 91, 89], [100, 100, 101, 100], True, "worse"),
        ([101, 108, 95, 101], [100, 100, 101, 99], True, "no difference that this test can see"),
        ([11, 11, 11], [11, 11, 11], True, "no difference"),
        ([12], [11], True, "one run: not decidable"),
        ([12, 13], [11, 11], True, "one run: not decidable"),
    ],
)
def test_the_verdict(ours: list[float], theirs: list[float], more_is_better: bool, words: str) -> None:
    found = verdict(ours, theirs, more_is_better=more_is_better)
    assert found.words == words
    assert found.difference == ours[0] - theirs[0]


def test_unlike_numbers_of_runs_are_refused() -> None:
    with pytest.raises(ValueError, match="as many of both"):
        verdict([1, 2], [1], more_is_better=True)
