"""Color2Gray: the exact greys against a solver of the paper's least squares, the pooled ones against the exact."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from oracle import photograph

from colmap_ihe.grey.methods.color2gray import ALPHA, THETA, color2gray, target
from colmap_ihe.grey.srgb import Float32, grey_of_lightness, lab


def wanted(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """The target difference of one pair, equation by equation of the paper."""
    dl, da, db = (float(a) - float(b) for a, b in zip(first, second, strict=True))
    crunched = ALPHA * math.tanh(math.hypot(da, db) / ALPHA)
    if abs(dl) > crunched:
        return dl
    return crunched if math.cos(THETA) * da + math.sin(THETA) * db >= 0 else -crunched


def exact(rgb: Float32) -> Float32:
    """`color2gray` with every pixel compared with every other and nothing pooled: for small images."""
    colours = lab(rgb).reshape(-1, 3)
    star = target(colours, colours, ALPHA, THETA).mean(axis=1) + colours[:, 0].mean()
    return grey_of_lightness(np.asarray(star, np.float32)).reshape(rgb.shape[:2])


def test_targets_are_those_of_the_paper() -> None:
    colours = lab(photograph(1, 8, 8)).reshape(-1, 3)
    found = target(colours, colours, ALPHA, THETA)
    expected = [[wanted(a, b) for b in colours] for a in colours]
    np.testing.assert_allclose(found, expected, atol=1e-3)
    np.testing.assert_array_equal(found, -found.T)


def test_the_exact_greys_solve_the_least_squares_over_all_pairs() -> None:
    image = photograph(2, 5, 6)
    colours = lab(image).reshape(-1, 3)
    count = len(colours)
    rows, sides = [], []
    for i in range(count):
        for j in range(i + 1, count):
            row = np.zeros(count)
            row[i], row[j] = 1, -1
            rows.append(row)
            sides.append(wanted(colours[i], colours[j]))
    solution = np.linalg.lstsq(np.array(rows), np.array(sides), rcond=None)[0]  # of least norm: mean 0
    star = np.asarray(solution + colours[:, 0].mean(), np.float32)  # nearest to L*
    np.testing.assert_allclose(exact(image).ravel(), grey_of_lightness(star), atol=1e-5)


def test_pooling_and_interpolating_cost_little() -> None:
    """In 8-bit levels, on noisy patches of 40 colours: half a level in the middle, a few where a hue turns."""
    image = photograph(3, 48, 64)
    off = 255 * np.abs(color2gray(image) - exact(image))
    assert np.median(off) < 0.5
    assert np.quantile(off, 0.99) < 3
    assert off.max() > 0


def test_colours_on_the_lattice_one_a_cell_are_exact() -> None:
    rng = np.random.default_rng(4)
    image = (rng.integers(0, 17, (20, 20, 3)) / 16).astype(np.float32)
    image[image == 1] = 31 / 32  # 1 shares its cell with 15 / 16
    image[image == 30 / 32] = 14 / 16
    np.testing.assert_allclose(color2gray(image), exact(image), atol=1e-5)


def test_two_isoluminant_colours_end_as_far_apart_as_the_target() -> None:
    """Half of each: g = mean L* +- target / 2."""
    image = np.zeros((4, 4, 3), np.float32)
    image[:2], image[2:] = (0.8, 0.25, 0.25), (0.25, 0.515, 0.25)
    warm, cool = lab(image[0, :1]), lab(image[3, :1])
    apart = wanted(warm[0], cool[0])
    assert apart == pytest.approx(ALPHA, abs=0.01)
    middle = (warm[0, 0] + cool[0, 0]) / 2
    expected = grey_of_lightness(np.array([middle + apart / 2, middle - apart / 2], np.float32))
    np.testing.assert_allclose(exact(image)[[0, 3], 0], expected, atol=1e-5)


def test_a_photograph_without_colour_stays_as_it_is() -> None:
    ramp = np.linspace(0, 1, 256, dtype=np.float32).reshape(16, 16, 1).repeat(3, axis=2)
    np.testing.assert_allclose(exact(ramp), ramp[..., 0], rtol=0, atol=2e-4)
