"""The Wallis filter against a plain loop over pixels, and where it must not run away."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.grey.wallis import BLOCK, BRIGHTNESS, CONTRAST, TARGET_DEVIATION, TARGET_MEAN, wallis


def looped(grey: NDArray[np.uint8], block: int) -> NDArray[np.float64]:
    """Pixel by pixel from the formula, sharing nothing with the package but its constants."""
    height, width = grey.shape
    down, across = (max(1, round(n / block)) for n in (height, width))
    top = [round(height * n / down) for n in range(down + 1)]
    left = [round(width * n / across) for n in range(across + 1)]
    blocks = [[grey[top[j] : top[j + 1], left[i] : left[i + 1]] for i in range(across)] for j in range(down)]
    mean = [[float(np.mean(b)) for b in row] for row in blocks]
    deviation = [[float(np.std(b)) for b in row] for row in blocks]

    def neighbours(edges: list[int], at: float) -> tuple[int, int, float]:
        centres = [(a + b) / 2 for a, b in pairwise(edges)]
        if at <= centres[0]:
            return 0, 0, 0.0
        for n, (a, b) in enumerate(pairwise(centres)):
            if at <= b:
                return n, n + 1, (at - a) / (b - a)
        return len(centres) - 1, len(centres) - 1, 0.0

    out = np.zeros(grey.shape)
    for y in range(height):
        for x in range(width):
            j, j2, v = neighbours(top, y + 0.5)
            i, i2, u = neighbours(left, x + 0.5)
            m, s = (
                (t[j][i] * (1 - u) + t[j][i2] * u) * (1 - v) + (t[j2][i] * (1 - u) + t[j2][i2] * u) * v
                for t in (mean, deviation)
            )
            gain = CONTRAST * TARGET_DEVIATION / (CONTRAST * s + (1 - CONTRAST) * TARGET_DEVIATION)
            out[y, x] = (grey[y, x] - m) * gain + BRIGHTNESS * TARGET_MEAN + (1 - BRIGHTNESS) * m
    return np.clip(out, 0, 255)


def picture(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    y, x = np.mgrid[0:height, 0:width]
    shade = 40 + 120 * x / width + 30 * np.sin(y / 5) * (y > height / 2)
    noisy = shade + np.random.default_rng(seed).normal(0, 6, (height, width))
    return np.asarray(np.clip(noisy, 0, 255), np.uint8)


@pytest.mark.parametrize(
    ("height", "width", "block"), [(64, 96, 16), (50, 71, 16), (33, 20, 64), (1, 9, 4), (7, 1, 2)]
)
def test_it_is_the_formula_pixel_by_pixel(height: int, width: int, block: int) -> None:
    grey = picture(height, width)
    found, exact = wallis(grey, block), looped(grey, block)
    assert found.dtype == np.uint8
    assert found.shape == grey.shape
    assert np.abs(found - exact).max() <= 0.5 + 1e-3


def test_strips_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    grey = picture(200, 150)
    whole = wallis(grey, 32)
    monkeypatch.setattr("colmap_ihe.grey.wallis._STRIP", 37)
    np.testing.assert_array_equal(wallis(grey, 32), whole)


def test_local_mean_and_contrast_come_nearer_to_their_targets() -> None:
    grey = picture(512, 512)
    found = wallis(grey)
    for before, after in ((grey[:128, :128], found[:128, :128]), (grey[-128:, -128:], found[-128:, -128:])):
        assert abs(after.mean() - TARGET_MEAN) < abs(before.mean() - TARGET_MEAN)
        assert abs(after.std() - TARGET_DEVIATION) < abs(before.std() - TARGET_DEVIATION)


@pytest.mark.parametrize("value", [0, 1, 127, 255])
def test_a_flat_picture_stays_flat(value: int) -> None:
    found = wallis(np.full((3 * BLOCK, 2 * BLOCK + 5), value, np.uint8))
    assert len(np.unique(found)) == 1
    assert abs(int(found[0, 0]) - (BRIGHTNESS * TARGET_MEAN + (1 - BRIGHTNESS) * value)) <= 0.5


def test_the_noise_of_a_flat_picture_grows_no_more_than_its_bound() -> None:
    grey = np.asarray(100 + np.random.default_rng(0).integers(0, 2, (256, 256)), np.uint8)
    found = wallis(grey)
    assert float(found.std()) <= CONTRAST / (1 - CONTRAST) * float(grey.std()) + 0.5


def test_a_flat_frame_beside_detail_divides_by_nothing() -> None:
    grey = np.zeros((256, 256), np.uint8)
    grey[64:192, 64:192] = picture(128, 128)
    with np.errstate(all="raise"):
        assert wallis(grey).max() > 0


def test_the_same_grey_is_another_one_elsewhere() -> None:
    """What the warning says: it is local."""
    grey = picture(256, 256)
    grey[32, 32] = grey[200, 230] = 100
    found = wallis(grey)
    assert abs(int(found[32, 32]) - int(found[200, 230])) > 10


@pytest.mark.parametrize(
    ("shape", "dtype", "block"),
    [((4, 4, 3), "u1", 64), ((4, 4), "f8", 64), ((0, 4), "u1", 64), ((4, 4), "u1", 0)],
)
def test_anything_else_is_refused(shape: tuple[int, ...], dtype: str, block: int) -> None:
    with pytest.raises(ValueError, match="expected"):
        wallis(np.zeros(shape, dtype), block)
