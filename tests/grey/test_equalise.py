"""Tone equalise: one curve for the set, from the histogram of all of it, that fills all levels alike."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import pooled

from colmap_ihe.errors import WeightsError
from colmap_ihe.grey.convert import to_grey, tone_table
from colmap_ihe.grey.equalise import curve_of, equalising_table
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.grey.weights import FIXED, Formula, Weights, grey_from_dict

TRIPLETS = [(0.3, 0.4, 0.3), (1.0, 0.0, 0.0), (0.0, 0.11, 0.89), FIXED["rgb2gray"]]


def photographs(seed: int = 0, count: int = 3) -> list[NDArray[np.uint16]]:
    """Smooth linear pictures, each of another brightness, most of it dark as RAW is."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:120, 0:160]
    found = []
    for n in range(count):
        waves = [np.sin(x / rng.uniform(5, 40) + y / rng.uniform(5, 40) + c) for c in range(3)]
        share = (0.5 + 0.45 * np.stack(waves, axis=2)) ** 2.2 * (0.3 + 0.3 * n)
        noisy = share + rng.normal(0, 0.01, share.shape) * np.sqrt(share)
        found.append(np.rint(65535 * np.clip(noisy, 0, 1)).astype(np.uint16))
    return found


def weights_of(images: list[NDArray[np.uint16]], triplet: tuple[float, float, float]) -> Weights:
    return Weights(*triplet, encoding="linear", curve=curve_of(pooled(images, "linear"), triplet))


def grey_counts(
    colours: dict[tuple[int, int, int], int], triplet: tuple[float, float, float]
) -> NDArray[Any]:
    """The definition, cell by cell in plain Python: even about the middle, as wide as three even spreads make it."""
    counts = np.zeros(65536)
    edges = [int(np.ceil(65535 * (c / 256) ** 2)) for c in range(256)] + [65536]
    for codes, pixels in colours.items():
        middle = square = 0.0
        for w, c in zip(triplet, codes, strict=True):
            middle += w / sum(triplet) * (edges[c] + edges[c + 1] - 1) / 2
            square += (w / sum(triplet) * (edges[c + 1] - 1 - edges[c])) ** 2
        first, last = round(middle - square**0.5 / 2), round(middle + square**0.5 / 2)
        first, last = min(max(first, 0), 65535), min(max(last, 0), 65535)
        for value in range(first, last + 1):
            counts[value] += pixels / (last - first + 1)
    return counts


@pytest.mark.parametrize("triplet", TRIPLETS)
def test_the_curve_is_that_of_its_definition(triplet: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(4)
    codes = [(10, 20, 30), (10, 21, 30), (100, 90, 95), (255, 255, 255), (0, 0, 0), (40, 60, 200)]
    colours = {c: int(n) for c, n in zip(codes, rng.integers(5, 60, len(codes)), strict=True)}
    values = np.repeat(np.array(codes), list(colours.values()), axis=0)
    lowest = np.ceil(65535 * (values / 256) ** 2).astype(np.uint16)
    table = equalising_table(curve_of(pooled([lowest[None]], "linear"), triplet))
    counts = grey_counts(colours, triplet)
    below = np.cumsum(counts) - counts
    exact = 256 * (below + counts / 2) / counts.sum()
    expected = np.clip(np.floor(exact), 0, 255)
    away = np.abs(table - expected)
    assert away.max() <= 1
    assert not away[np.abs(exact - np.rint(exact)) > 1e-6].any()  # elsewhere sums may round either way


@pytest.mark.parametrize("triplet", TRIPLETS)
def test_pixels_fall_where_counting_them_one_by_one_puts_them(triplet: tuple[float, float, float]) -> None:
    images = photographs()
    weights = weights_of(images, triplet)
    shares = np.array(triplet) / sum(triplet)
    greys = np.concatenate([(rgb @ shares).ravel() for rgb in images])
    ordered = np.sort(greys)
    ranks = np.searchsorted(ordered, greys, side="left") + np.searchsorted(ordered, greys, side="right")
    exact = np.floor(256 * ranks / 2 / len(greys))
    levels = np.concatenate([to_grey(rgb, weights, "equalise").ravel() for rgb in images])
    assert np.abs(levels - exact).max() <= 2
    assert np.abs(levels - exact).mean() < 0.2


def test_all_levels_hold_about_as_many_pixels() -> None:
    images = photographs()
    weights = weights_of(images, (0.3, 0.4, 0.3))
    counts = {}
    for tone in ("equalise", "sqrt"):
        levels = np.concatenate([to_grey(i, weights, tone).ravel() for i in images])
        counts[tone] = np.bincount(levels, minlength=256) / levels.size * 256
    assert counts["equalise"][1:-1].min() > 0.6
    assert counts["equalise"][1:-1].max() < 1.5
    assert counts["equalise"].std() < 0.2 * counts["sqrt"].std()


def test_the_same_colour_is_the_same_grey_in_every_image() -> None:
    images = photographs()
    weights = weights_of(images, (0.3, 0.5, 0.2))
    dark, bright = images[0].copy(), images[2].copy()
    dark[2, 3] = bright[7, 1] = (12000, 24000, 7000)
    assert to_grey(dark, weights, "equalise")[2, 3] == to_grey(bright, weights, "equalise")[7, 1]


@given(st.lists(st.tuples(*[st.integers(0, 65535)] * 3), min_size=1, max_size=40), st.sampled_from(TRIPLETS))
def test_brighter_is_never_darker(
    colours: list[tuple[int, int, int]], triplet: tuple[float, float, float]
) -> None:
    table = equalising_table(curve_of(pooled([np.array([colours], np.uint16)], "linear"), triplet))
    assert table.shape == (65536,)
    assert table.dtype == np.uint8
    assert (np.diff(table.astype(int)) >= 0).all()


def test_one_value_for_all_is_the_middle() -> None:
    weights = weights_of([np.full((64, 64, 3), 20000, np.uint16)], (0.3, 0.4, 0.3))
    level = to_grey(np.full((1, 1, 3), 20000, np.uint16), weights, "equalise")[0, 0]
    assert 85 <= level <= 170


def test_images_that_count_the_same_weigh_the_same() -> None:
    small, large = photographs(count=2)
    twice = [np.concatenate([large, large]), small]
    by_image = pooled(twice, "linear", "image")
    expected = np.array(curve_of(pooled([small, large], "linear"), (0.3, 0.4, 0.3)))
    found = np.array(curve_of(by_image, (0.3, 0.4, 0.3)))
    assert np.abs(found - expected).max() <= 1


def test_linear_weights_of_a_fit_hold_their_curve_and_it_survives_files() -> None:
    images = photographs()
    weights = fit_weights(images, 0.25)
    assert weights.curve == curve_of(pooled(images, "linear"), weights.triplet)
    assert grey_from_dict(json.loads(json.dumps(weights.as_dict()))) == weights
    text = yaml.safe_dump(weights.as_dict(), default_flow_style=None)
    assert grey_from_dict(yaml.safe_load(text)) == weights
    coded = fit_weights([np.random.default_rng(0).integers(0, 256, (30, 30, 3), np.uint8)], 0.25)
    assert not coded.curve
    assert "curve" not in coded.as_dict()


@pytest.mark.parametrize(
    ("encoding", "curve"),
    [
        *(("linear", (1, 2, 3)), ("linear", (5,) * 254 + (4,)), ("coded", tuple(range(255)))),
        *(("linear", (value,) * 255) for value in (-1, 65537, 1.5, "1")),
    ],
)
def test_a_curve_that_is_none_is_refused(encoding: str, curve: tuple[Any, ...]) -> None:
    with pytest.raises(WeightsError, match="curve"):
        grey_from_dict({"weights": [1, 0, 0], "encoding": encoding, "curve": list(curve)})


def test_no_table_without_a_curve() -> None:
    with pytest.raises(ValueError, match="expected 'sqrt' or 'linear'"):
        tone_table(1.0, "equalise")


def test_coded_photographs_keep_their_tones() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    for grey in (Weights(0.3, 0.4, 0.3), Formula(method="value")):
        np.testing.assert_array_equal(to_grey(rgb, grey, "equalise"), to_grey(rgb, grey))


def test_of_coded_or_no_pixels_there_is_no_curve() -> None:
    for histogram in (Histogram("linear"), Histogram("coded")):
        with pytest.raises(ValueError, match="expected pixels of linear"):
            curve_of(histogram, (1, 0, 0))
