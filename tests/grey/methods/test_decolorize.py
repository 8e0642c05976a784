"""Decolorize against its formula written out once more over whole images, and pooling over a set."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from oracle import photograph

from colmap_ihe.grey.methods.decolorize import DecolorizeSet, apply_decolorize, decolorize, quantiles


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


def test_a_set_of_one_or_of_the_same_twice_is_as_the_photograph_alone() -> None:
    image = photograph(3)
    once, twice = DecolorizeSet(), DecolorizeSet()
    once.add(image)
    twice.add(image)
    twice.add(image)
    assert once.finish() == twice.finish()
    np.testing.assert_array_equal(apply_decolorize(image, twice.finish()), decolorize(image))


def test_quantiles_are_the_least_value_with_that_share_at_or_below() -> None:
    values, mass = np.array([3.0, 1.0, 2.0]), np.array([1, 2, 7])  # 1 1 2 2 2 2 2 2 2 3
    assert quantiles(values, mass, [0.0, 0.2, 0.21, 0.9, 0.91, 1.0]) == [1, 1, 2, 2, 3, 3]
