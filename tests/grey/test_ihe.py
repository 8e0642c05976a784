"""The fit against a plain loop over every triplet and every pixel."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import Triplet, pooled, scene

from colmap_ihe.grey.histogram import Histogram, Weighting
from colmap_ihe.grey.ihe import count_levels, fit_histogram, white_point
from colmap_ihe.grey.weights import Weights, triplets

Counts = Callable[[Sequence[Triplet], Sequence[int]], NDArray[np.int64]]


def hundredths(weights: Weights) -> Triplet:
    red, green, blue = (round(100 * w) for w in weights.triplet)
    return red, green, blue


def assert_agrees(weights: Weights, best: oracle.Best, rel: float = 1e-9) -> None:
    assert hundredths(weights) == best.triplet
    assert weights.score == pytest.approx(best.score, rel=rel, abs=1e-12)
    assert weights.tones == best.tones


def test_all_5151_triplets_of_a_small_set() -> None:
    images = [scene(seed, 40, 56) for seed in range(3)]
    weights = fit_histogram(pooled(images), triplets(0.01))
    assert_agrees(weights, oracle.fit(images, 1))
    assert (weights.images, weights.pixels, weights.method) == (3, 3 * 40 * 56, "ihe")


def test_a_burnt_out_sky_is_counted_like_any_other_colour() -> None:
    image = scene(7, 64, 64)
    image[:40] = 255
    assert_agrees(fit_histogram(pooled([image]), triplets(0.01)), oracle.fit([image], 1))


@pytest.mark.parametrize("weighting", ["pixel", "image"])
def test_photographs_of_several_sizes(weighting: Weighting) -> None:
    images = [scene(11, 200, 300, colours=6), scene(12, 48, 40, colours=9), scene(13, 64, 65, colours=3)]
    found = fit_histogram(pooled(images, weighting=weighting), triplets(0.05))
    best = oracle.fit(images, 5, images_count_equally=weighting == "image")
    # The mass of a pixel under `image` is rounded to a whole number of 2^36 shares.
    assert_agrees(found, best, rel=1e-4 if weighting == "image" else 1e-9)
    other = oracle.fit(images, 5, images_count_equally=weighting != "image")
    assert other.triplet != best.triplet  # else the test could not tell the two apart


@st.composite
def odd_images(draw: st.DrawFn) -> NDArray[np.uint8]:
    """Few colours, extremes and flat areas: where bounds are tight and ties are common."""
    palette = draw(
        st.lists(st.tuples(*[st.sampled_from([0, 1, 2, 50, 127, 128, 254, 255])] * 3), min_size=1, max_size=6)
    )
    shape = draw(st.tuples(st.integers(1, 6), st.integers(1, 6)))
    picks = draw(st.lists(st.integers(0, len(palette) - 1), min_size=36, max_size=36))
    colours = np.array(palette, np.uint8)[np.array(picks)]
    return np.asarray(colours[: shape[0] * shape[1]].reshape(*shape, 3))


@settings(max_examples=40)
@given(st.lists(odd_images(), min_size=1, max_size=3))
def test_odd_sets_ties_included(images: list[NDArray[np.uint8]]) -> None:
    assert_agrees(fit_histogram(pooled(images), triplets(0.1)), oracle.fit(images, 10))


def test_ties_go_to_the_triplet_nearest_to_rec709() -> None:
    """All triplets give a grey picture the same grey. Nearest of the grid to .2126 .7152 .0722: 21 72 7,
    at a squared distance of 3.5e-5; 22 71 7 has 8.7e-5 and 21 71 8 has 9.5e-5."""
    grey = np.repeat(np.arange(256, dtype=np.uint8).reshape(16, 16, 1), 3, axis=2)
    weights = fit_histogram(pooled([grey]), triplets(0.01))
    assert hundredths(weights) == (21, 72, 7)
    assert weights.score == pytest.approx(0, abs=1e-15)  # perfectly flat
    assert weights.tones == 256


def test_equally_flat_triplets_are_told_apart_by_their_tones() -> None:
    """Equal sums of squares over more or fewer levels, as of 2 2 2 2 and 3 2 1 1 1: found by trying."""
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(400):
        image = rng.choice(np.array([0, 85, 170, 255], np.uint8), (3, 3, 3))
        squares: dict[int, set[int]] = {}
        for triplet in oracle.grid(50):
            counts = np.bincount(oracle.coded_levels(image, triplet).ravel(), minlength=256)
            squares.setdefault(int((counts**2).sum()), set()).add(int((counts > 0).sum()))
        if len(squares[min(squares)]) > 1:
            found += 1
            assert_agrees(fit_histogram(pooled([image]), triplets(0.5)), oracle.fit([image], 50))
    assert found > 3


def test_one_colour_has_the_worst_score_there_is() -> None:
    weights = fit_histogram(pooled([np.full((8, 8, 3), (10, 200, 30), np.uint8)]), triplets(0.1))
    assert weights.score == pytest.approx(1 - 1 / 256)
    assert weights.tones == 1


def linear_scene(seed: int, height: int, width: int) -> NDArray[np.uint16]:
    """Sensor values of `scene`: gains .5 1 .62, photon noise, most of it dark, some of it saturated."""
    rng = np.random.default_rng(seed)
    light = (scene(seed, height, width) / 255.0) ** 2.2 * (0.5, 1.0, 0.62) * 1.1
    electrons = rng.poisson(light * 20_000) / 20_000
    return np.asarray(np.clip(np.rint(electrons * 65535), 0, 65535), np.uint16)


def recount_of(images: Sequence[NDArray[np.uint16]], asked: dict[Triplet, int]) -> Counts:
    """Counts what the fit asks for, and notes with which white points."""

    def recount(chosen: Sequence[Triplet], whites: Sequence[int]) -> NDArray[np.int64]:
        asked.update(zip(chosen, whites, strict=True))
        counts = [
            sum(np.bincount(oracle.linear_levels(image, t, w).ravel(), minlength=256) for image in images)
            for t, w in zip(chosen, whites, strict=True)
        ]
        return np.array(counts, np.int64)

    return recount


def white_of(histogram: Histogram, triplet: Triplet) -> int:
    """The white point in hundredths of a 16-bit value."""
    red, green, blue = triplet
    return round(white_point(histogram, (red / 100, green / 100, blue / 100)) * 100 * 65535)


def test_linear_sets() -> None:
    images = [linear_scene(seed, 64, 96) for seed in (3, 4)]
    histogram = pooled(images, "linear")
    whites: dict[Triplet, int] = {}
    weights = fit_histogram(histogram, triplets(0.01), recount_of(images, whites))
    assert len(whites) == 5151
    best = oracle.fit(images, 1, lambda rgb, t: oracle.linear_levels(rgb, t, whites[t]))
    assert_agrees(weights, best)
    assert weights.encoding == "linear"
    assert weights.white == pytest.approx(whites[best.triplet] / (100 * 65535))
    for triplet in oracle.grid(50):
        assert whites[triplet] == white_of(histogram, triplet)


@pytest.mark.parametrize("triplet", [(0, 100, 0), (100, 0, 0), (30, 30, 40), (3, 0, 97)])
def test_white_is_the_998th_thousandth_of_the_grey(triplet: Triplet) -> None:
    images = [linear_scene(seed, 200, 300) for seed in (1, 2)]
    grey = np.concatenate([(image.reshape(-1, 3) @ np.array(triplet) / 6553500) for image in images])
    found = white_of(pooled(images, "linear"), triplet) / 6553500
    # Cells are 4/256 of the square root wide, and count with their middle.
    assert np.percentile(grey, 99.5) * 0.96 < found < np.percentile(grey, 99.95) * 1.04
    assert 0 < found <= 1


def test_levels_are_counted_in_full_depth() -> None:
    rng = np.random.default_rng(9)
    image = rng.integers(0, 65536, (300, 400, 3), np.uint16)
    chosen: list[Triplet] = [(100, 0, 0), (33, 33, 34), (0, 1, 99)]
    whites = [6553600, 3000320, 1024]
    counts = count_levels(image, chosen, whites)
    for n, (triplet, white) in enumerate(zip(chosen, whites, strict=True)):
        expected = np.bincount(oracle.linear_levels(image, triplet, white).ravel(), minlength=256)
        np.testing.assert_array_equal(counts[n], expected)


def test_what_cannot_be_fitted_is_refused() -> None:
    with pytest.raises(ValueError, match="empty"):
        fit_histogram(Histogram(), triplets())
    with pytest.raises(ValueError, match="recount"):
        fit_histogram(pooled([linear_scene(1, 8, 8)], "linear"), triplets())


def test_white_of_the_mean_is_that_of_any_other_grey_where_all_is_neutral() -> None:
    grey = np.repeat(linear_scene(3, 80, 90)[..., :1], 3, axis=2)
    histogram = pooled([grey], "linear")
    assert white_point(histogram, (1 / 3, 1 / 3, 1 / 3)) == white_point(histogram, (0, 1, 0))
