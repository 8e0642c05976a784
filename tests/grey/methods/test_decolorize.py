"""Decolorize against its formula written out once more over whole images, and pooling over a set."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import scene

from colmap_ihe.grey.methods.decolorize import DecolorizeSet, apply_decolorize, decolorize, quantiles


def photograph(seed: int, height: int = 40, width: int = 60) -> NDArray[np.float32]:
    return scene(seed, height, width).astype(np.float32) / np.float32(255)


def restated(
    images: list[NDArray[np.float32]], effect: float = 0.5, noise: float = 0.001
) -> list[NDArray[np.float64]]:
    """Grundland and Dodgson's algorithm over all images at once, in double precision."""
    planes = []
    axis = np.zeros(2)
    for image in images:
        rgb = image.astype(np.float64)
        red, green, blue = np.moveaxis(rgb, -1, 0)
        ypq = np.stack(
            [0.298936 * red + 0.587043 * green + 0.114021 * blue, (red + green) / 2 - blue, red - green]
        )
        planes.append(ypq)
        height, width = red.shape
        scale = np.sqrt(2 * min(height, width)) * np.sqrt(2 / np.pi)
        shift = np.rint(scale * np.random.default_rng(2007).standard_normal((2, height, width))).astype(int)
        mirrored = [np.pad(np.arange(n), 8 * n, mode="symmetric") for n in (height, width)]
        for y in range(height):
            for x in range(width):
                v = mirrored[0][y + shift[0, y, x] + 8 * height]
                u = mirrored[1][x + shift[1, y, x] + 8 * width]
                dy, dp, dq = ypq[:, y, x] - ypq[:, v, u]
                contrast = np.linalg.norm(rgb[y, x] - rgb[v, u]) + 1e-10
                axis += (1 - abs(dy) / 0.668568 / contrast) * np.sign(dy) * np.array([dp, dq])
    axis /= np.linalg.norm(axis)
    y, p, q = np.concatenate([plane.reshape(3, -1) for plane in planes], axis=1)

    def quantile(values: NDArray[np.float64], share: float) -> float:
        return float(np.quantile(values, share, method="inverted_cdf"))

    reach = quantile(np.abs(p * axis[0] + q * axis[1]), 1 - noise)
    tones = y + effect * (p * axis[0] + q * axis[1]) / reach
    low, high = quantile(tones, noise), quantile(tones, 1 - noise)
    dark, bright = (1 - effect) * quantile(y, noise), effect + (1 - effect) * quantile(y, 1 - noise)
    greys = []
    for y, p, q in planes:
        tone = dark + (y + effect * (p * axis[0] + q * axis[1]) / reach - low) * (bright - dark) / (
            high - low
        )
        room = effect / 1.118034 * np.sqrt(p**2 + q**2)
        greys.append(np.clip(np.minimum(np.maximum(tone, y - room), y + room), 0, 1))
    return greys


def test_one_photograph_is_as_the_formula_says() -> None:
    image = photograph(1)
    np.testing.assert_allclose(decolorize(image), restated([image])[0], atol=2e-5)


def test_a_set_is_as_the_formula_says_over_all_pixels() -> None:
    images = [photograph(1), photograph(2, 30, 80)]
    fitted = DecolorizeSet()
    for image in images:
        fitted.add(image)
    for image, expected in zip(images, restated(images), strict=True):
        np.testing.assert_allclose(apply_decolorize(image, fitted.finish()), expected, atol=2e-5)


@settings(max_examples=8)  # each set holds 128 MB
@given(st.permutations(range(4)), st.integers(0, 4))
def test_order_and_grouping_change_nothing(order: list[int], cut: int) -> None:
    images = [photograph(n, 20 + n, 30) for n in range(4)]
    whole, first, second = DecolorizeSet(), DecolorizeSet(), DecolorizeSet()
    for image in images:
        whole.add(image)
    for n in order[:cut]:
        first.add(images[n])
    for n in order[cut:]:
        second.add(images[n])
    assert (first + second).finish() == whole.finish()


def test_a_set_of_one_or_of_the_same_twice_is_as_the_photograph_alone() -> None:
    image = photograph(3)
    once, twice = DecolorizeSet(), DecolorizeSet()
    once.add(image)
    twice.add(image)
    twice.add(image)
    assert once.finish() == twice.finish()
    np.testing.assert_array_equal(apply_decolorize(image, twice.finish()), decolorize(image))


def test_a_photograph_without_colour_stays_as_it_is() -> None:
    ramp = np.linspace(0, 1, 256, dtype=np.float32).reshape(16, 16, 1).repeat(3, axis=2)
    np.testing.assert_allclose(decolorize(ramp), ramp[..., 0], atol=1e-6)


def test_quantiles_are_the_least_value_with_that_share_at_or_below() -> None:
    values, mass = np.array([3.0, 1.0, 2.0]), np.array([1, 2, 7])  # 1 1 2 2 2 2 2 2 2 3
    assert quantiles(values, mass, [0.0, 0.2, 0.21, 0.9, 0.91, 1.0]) == [1, 1, 2, 2, 3, 3]


def test_an_empty_set_is_refused() -> None:
    with pytest.raises(ValueError, match="no photographs"):
        DecolorizeSet().finish()
