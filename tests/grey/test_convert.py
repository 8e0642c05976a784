"""Colour to grey: the formula to the last integer, and what it must never do."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from colmap_ihe.grey.convert import to_colour, to_grey, tone_table
from colmap_ihe.grey.ihe import fit_histogram
from colmap_ihe.grey.weights import FIXED, Weights, triplets

Tone = Literal["sqrt", "linear"]

any_triplet = st.integers(0, 100).flatmap(
    lambda i: st.integers(0, 100 - i).map(lambda j: (i, j, 100 - i - j))
)


def of(triplet: tuple[int, int, int], **more: Any) -> Weights:
    red, green, blue = triplet
    return Weights(red / 100, green / 100, blue / 100, **more)


@given(any_triplet, st.integers(0, 2**32 - 1))
def test_coded_grey_is_the_nearest_integer_halves_up(triplet: tuple[int, int, int], seed: int) -> None:
    rgb = np.random.default_rng(seed).integers(0, 256, (20, 30, 3), np.uint8)
    grey = to_grey(rgb, of(triplet))
    assert grey.dtype == np.uint8
    np.testing.assert_array_equal(grey, oracle.coded_levels(rgb, triplet))


@pytest.mark.parametrize("method", FIXED)
def test_fixed_conversions_round_to_the_nearest_level_and_keep_greys(method: str) -> None:
    ramp = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_array_equal(to_grey(np.dstack([ramp] * 3), Weights(*FIXED[method])), ramp)
    rgb = np.random.default_rng(1).integers(0, 256, (40, 50, 3), np.uint8)
    triplet = np.array(FIXED[method])
    exact = rgb.astype(np.float64) @ (triplet / triplet.sum())
    assert np.abs(to_grey(rgb, Weights(*FIXED[method])) - exact).max() <= 0.5 + 1e-4


def test_isoluminant_colours_come_apart_that_rec709_merges() -> None:
    """A green and a blue of equal Rec.709 grey: 0.7152 x (100 - 83) = 12.2, 0.0722 x (228 - 60) = 12.1."""
    green, blue = (60, 100, 60), (60, 83, 228)
    rgb = np.zeros((32, 32, 3), np.uint8)
    rgb[:, :16], rgb[:, 16:] = green, blue
    default = to_grey(rgb, Weights(*FIXED["rec709"]))
    assert abs(int(default[0, 0]) - int(default[0, 31])) <= 1
    noisy = rgb + np.random.default_rng(1).integers(0, 12, rgb.shape, np.uint8)
    fitted = to_grey(rgb, fit_histogram(oracle.pooled([noisy]), triplets()))
    assert abs(int(fitted[0, 0]) - int(fitted[0, 31])) > 8


@pytest.mark.parametrize("tone", ["sqrt", "linear"])
def test_the_same_linear_colour_is_the_same_grey_in_every_image(tone: Tone) -> None:
    weights = of((30, 50, 20), encoding="linear", white=0.6)
    dark, bright = np.zeros((6, 7, 3), np.uint16), np.full((9, 5, 3), 65535, np.uint16)
    dark[2, 3] = bright[7, 1] = (12000, 24000, 7000)
    first, second = to_grey(dark, weights, tone)[2, 3], to_grey(bright, weights, tone)[7, 1]
    assert first == second
    share = (0.3 * 12000 + 0.5 * 24000 + 0.2 * 7000) / 65535 / 0.6
    assert abs(int(first) - 255 * (share**0.5 if tone == "sqrt" else share)) <= 1


@pytest.mark.parametrize("tone", ["sqrt", "linear"])
@pytest.mark.parametrize("white", [0.01, 0.37, 1.0])
def test_tone_tables_rise_from_black_to_white(tone: Tone, white: float) -> None:
    table = tone_table(white, tone).astype(int)
    assert table.shape == (65536,)
    assert (np.diff(table) >= 0).all()
    assert table[0] == 0
    assert table[round(white * 65535)] == table[-1] == 255
    assert table[round(white * 65535 / 4)] == pytest.approx(127.5 if tone == "sqrt" else 63.75, abs=1)


def test_linear_weights_are_applied_before_the_tone_curve() -> None:
    """Coding first and weighing then gives 0.5 x 255 = 128 here, weighing first 255 sqrt(.5) = 180."""
    rgb = np.array([[[65535, 0, 0]]], np.uint16)
    weights = Weights(0.5, 0.5, 0, encoding="linear")
    assert to_grey(rgb, weights)[0, 0] == 180
    assert to_grey(rgb, weights, "linear")[0, 0] == 128


@pytest.mark.parametrize(
    ("encoding", "rgb"),
    [
        *(("coded", np.zeros(shape, np.uint8)) for shape in ((4, 4), (4, 4, 4))),
        ("coded", np.zeros((4, 4, 3), np.uint16)),
        *(("linear", np.zeros((4, 4, 3), dtype)) for dtype in (np.uint8, np.float64)),
    ],
)
def test_what_does_not_fit_the_weights_is_refused_with_what_came(encoding: Any, rgb: NDArray[Any]) -> None:
    with pytest.raises(ValueError, match=rf"rgb\.shape=.*{rgb.dtype}.*expected \(H, W, 3\)"):
        to_grey(rgb, Weights(1, 0, 0, encoding=encoding))


NIKON = np.array(((1.661, -0.579, -0.082), (-0.14, 1.557, -0.417), (0.009, -0.457, 1.448)))
"""A matrix from balanced sensor colours to sRGB: of a D3100, as LibRaw has it."""


@pytest.mark.parametrize("white", [0.7, 1.0])
@pytest.mark.parametrize("balance", [(2.397, 1.0, 1.4), (0.9, 1.0, 1.7)])
def test_what_is_blown_out_is_white_in_the_colour_twin(
    white: float, balance: tuple[float, float, float]
) -> None:
    matrix = NIKON @ np.diag(balance)
    rgb = np.array([[[65535, 65535, 65535], [30000, 65535, 50000], [65535, 40000, 65535]]], np.uint16)
    assert to_colour(rgb, matrix, white)[0, 0].tolist() == [255, 255, 255]
    grey = np.rint(0.3 * 65535 / np.array(balance)).astype(np.uint16)
    colour = to_colour(grey[None, None], matrix, white)[0, 0]
    assert np.ptp(colour) <= 1
    assert colour[1] == pytest.approx(
        255 * (1.055 * (0.3 / min(white, *balance)) ** (1 / 2.4) - 0.055), abs=1
    )


def test_what_is_blown_out_has_no_colour_after_gains() -> None:
    """A photograph made darker, and balanced, before: its saturated pixels are no longer at the end of the range."""
    gains = (0.5, 0.4, 0.45)
    saturated = np.rint(np.array(gains) * 65535).astype(np.uint16)
    colour = to_colour(saturated[None, None], NIKON @ np.diag((2.0, 1.0, 1.4)), 1.0, gains)[0, 0]
    assert np.ptp(colour) <= 1


def test_colour_twin_is_srgb_with_the_white_of_the_set() -> None:
    """sRGB of linear 0.5 is 188, of 0.2 is 124 (IEC 61966-2-1)."""
    rgb = np.array([[[65535 // 4] * 3, [65535 // 10] * 3, [65535 // 2] * 3, [0, 0, 0]]], np.uint16)
    colour = to_colour(rgb, np.eye(3), white=0.5)
    assert colour.dtype == np.uint8
    np.testing.assert_array_equal(colour[0, :, 0], [188, 124, 255, 0])
    np.testing.assert_array_equal(colour[..., 0], colour[..., 2])
    swapped = to_colour(np.array([[[65535, 0, 0]]], np.uint16), np.eye(3)[[2, 1, 0]], 1.0)
    np.testing.assert_array_equal(swapped[0, 0], [0, 0, 255])
