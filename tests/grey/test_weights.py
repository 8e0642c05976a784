"""The triplet and its file: what is taken, what is refused, and that it comes back as it went."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from colmap_ihe.errors import WeightsError
from colmap_ihe.grey.weights import FIXED, Weights, grey_from_dict, triplets


# C(102, 2) and C(12, 2): the ways to write 100, or 10, as an ordered sum of three.
@pytest.mark.parametrize(("step", "count"), [(0.01, 5151), (0.1, 66), (0.05, 231), (0.25, 15), (1, 3)])
def test_the_grid_holds_every_triplet_once_in_order(step: float, count: int) -> None:
    grid = triplets(step)
    assert len(grid) == len(set(grid)) == count == math.comb(round(1 / step) + 2, 2)
    assert grid == sorted(grid)
    assert all(sum(t) == 100 and min(t) >= 0 for t in grid)
    assert all(w % round(100 * step) == 0 for t in grid for w in t)


@pytest.mark.parametrize("step", [0, -0.1, 0.03, 0.005, 0.015, 0.3, 2, 0.0999])
def test_a_step_that_does_not_divide_one_is_refused(step: float) -> None:
    with pytest.raises(WeightsError, match=f"step={step}"):
        triplets(step)


@pytest.mark.parametrize(
    "triplet",
    [(0.5, 0.5, 0.5), (1.2, -0.2, 0), (math.nan, 0.5, 0.5), (math.inf, 0, 0), (0.3, 0.3, 0.3), (0, 0, 0)],
)
def test_weights_that_do_not_sum_to_one_are_refused(triplet: tuple[float, float, float]) -> None:
    with pytest.raises(WeightsError, match="sum to") as caught:
        Weights(*triplet)
    assert "weights file" in caught.value.hint


@pytest.mark.parametrize(
    "changes", [{"encoding": "log"}, {"white": 0.0}, {"white": 1.5}, {"white": math.nan}]
)
def test_another_encoding_or_white_point_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(WeightsError, match="expected 'coded' or 'linear'"):
        Weights(1, 0, 0, **changes)


def test_every_fixed_conversion_is_a_valid_triplet() -> None:
    for name, triplet in FIXED.items():
        assert Weights(*triplet, method=name).triplet == triplet


# The published coefficients: ITU-R BT.709-6, section 3.2; MATLAB's documentation of rgb2gray.
def test_fixed_conversions_are_as_published() -> None:
    assert FIXED["rec709"] == (0.2126, 0.7152, 0.0722)
    assert FIXED["rgb2gray"] == (0.2989, 0.5870, 0.1140)


@given(
    st.integers(0, 100).flatmap(lambda i: st.tuples(st.just(i), st.integers(0, 100 - i))),
    st.sampled_from(["coded", "linear"]),
    st.floats(1e-6, 1),
    st.none() | st.floats(0, 1),
    st.none() | st.integers(1, 256),
)
def test_weights_survive_yaml_and_json(
    two: tuple[int, int], encoding: Any, white: float, score: float | None, tones: int | None
) -> None:
    red, green = two
    triplet = (red / 100, green / 100, (100 - red - green) / 100)
    weights = Weights(*triplet, "ihe", encoding, score, tones, white, images=11, pixels=12345)
    assert grey_from_dict(yaml.safe_load(yaml.safe_dump(weights.as_dict()))) == weights
    assert grey_from_dict(json.loads(json.dumps(weights.as_dict()))) == weights


def test_a_file_with_nothing_but_weights_is_enough() -> None:
    weights = grey_from_dict({"weights": [0.2, 0.3, 0.5]})
    assert isinstance(weights, Weights)
    assert weights.triplet == (0.2, 0.3, 0.5)
    assert (weights.encoding, weights.white, weights.score) == ("coded", 1.0, None)


@pytest.mark.parametrize(
    "values",
    [
        None, [], "weights", 3, {}, {"weights": None}, {"weights": [1, 0]}, {"weights": ["a", "b", "c"]},
        {"weights": [0.25, 0.25, 0.25, 0.25]}, {"weights": [0.5, 0.5, 0.5]},
        {"weights": [0.2, 0.3, 0.5], "images": math.inf}, {"weights": [1, 0, 0], "tones": []},
        {"weights": [1, 0, 0], "white": "bright"},
        {"weights": [1, 0, 0], "score": "high"}, {"weights": [1, 0, 0], "encoding": ["coded"]},
        {"weights": None, "method": "cie-y", "parameters": [], "encoding": "linear", "white": 0},
        {"weights": None, "method": "decolorize-set", "parameters": [math.nan]},
        {"weights": None, "method": "cie-y", "parameters": [], "encoding": "other"},
        {"weights": None, "method": "cie-y"},
    ],
)  # fmt: skip
def test_anything_else_is_no_weights_file(values: Any) -> None:
    told = r"^my weights\.yaml: not a weights file|^(weights|encoding|parameters) .*; expected "
    with pytest.raises(WeightsError, match=told) as caught:
        grey_from_dict(values, "my weights.yaml")
    assert caught.value.hint
