"""Realtime against its objective written out with loops, a case solved by hand, and pooling over a set."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from oracle import photograph

from colmap_ihe.grey.methods.realtime import GRID, RealtimeSet, pairs, realtime


def fitted(images: list[NDArray[np.float32]]) -> RealtimeSet:
    found = RealtimeSet()
    for image in images:
        found.add(image)
    return found


def nearest(image: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    height, width = (round(n * scale) for n in image.shape[:2])
    small = np.zeros((height, width, 3))
    for y in range(height):
        for x in range(width):
            small[y, x] = image[
                int((y + 0.5) * image.shape[0] / height), int((x + 0.5) * image.shape[1] / width)
            ]
    return small


def objective(images: list[NDArray[np.float32]]) -> NDArray[np.float64]:
    """Mean of log(exp(-(L + d)^2 / s^2) + exp(-(L - d)^2 / s^2)) over all pairs, for the 66 triplets."""
    sums, count = np.zeros(66, np.longdouble), 0
    for image in images:
        small = nearest(image.astype(np.float64), 64 / np.sqrt(image.shape[0] * image.shape[1]))
        half = nearest(small, 0.5)
        flat = [colour for row in small for colour in row]
        chosen = [
            a - flat[n] for a, n in zip(flat, np.random.default_rng(2012).permutation(len(flat)), strict=True)
        ]
        chosen += [row[x + 1] - row[x] for row in half for x in range(len(row) - 1)]
        chosen += [b - a for above, below in pairwise(half) for a, b in zip(above, below, strict=True)]
        for difference in chosen:
            d = np.linalg.norm(difference) / 1.41
            if d < 0.05:
                continue
            grey = np.asarray(GRID @ difference, np.longdouble)  # whose exponent holds exp(-1600)
            sums += np.log(np.exp(-(((grey + d) / 0.05) ** 2)) + np.exp(-(((grey - d) / 0.05) ** 2)))
            count += 1
    return np.asarray(sums / count, np.float64)


def test_the_sums_are_the_objective() -> None:
    images = [photograph(1, 90, 120), photograph(2, 70, 200)]
    found = fitted(images)
    expected = objective(images)
    np.testing.assert_allclose(np.array(found.sums) / 2**32 / found.pairs, expected, rtol=1e-6)
    assert found.finish() == pytest.approx(tuple(GRID[expected.argmax()]))


def test_the_grey_is_the_weighted_sum() -> None:
    image = photograph(3, 90, 120)
    np.testing.assert_allclose(realtime(image), image @ np.array(fitted([image]).finish()), atol=1e-6)


def test_red_on_black_is_solved_by_hand() -> None:
    """A pair (c, 0, 0) has contrast c / 1.41, which wr c meets best with wr = 0.7 of the tenths. Green and
    blue do not matter: of 0.3, all to green is the nearest to Rec.709."""
    image = np.zeros((64, 64, 3), np.float32)
    image[:, 32:, 0] = 0.8
    assert fitted([image]).finish() == (0.7, 0.3, 0.0)


def test_without_colour_the_weights_are_nearest_to_rec709() -> None:
    flat = np.full((50, 50, 3), 0.4, np.float32)
    assert fitted([flat]).finish() == (0.2, 0.7, 0.1)
    np.testing.assert_allclose(realtime(flat), 0.4, atol=1e-6)


def test_pairs_of_a_large_photograph_are_no_more_than_of_a_small_one() -> None:
    large, _ = pairs(photograph(4, 600, 800))
    assert len(large) <= 64 * 64 + 2 * 32 * 32 + 200
