"""Contrast over noise: adding is pooling, known noise is found, the best triplet is the eigenvector's."""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.grey.contrast import _GREEN_SHARE, CLOSENESS, DEFAULT_ENOUGH, Contrast
from colmap_ihe.grey.weights import FIXED, Encoding, triplets

GRID = triplets()


def texture(seed: int, height: int, width: int) -> NDArray[np.float32]:
    """(H, W) float32 in about [-1, 1]: detail of all sizes."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width), np.float32)
    for cell in (3, 6, 12, 24, 48):
        coarse = rng.standard_normal((height // cell + 2, width // cell + 2)).astype(np.float32)
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.tanh(total / 3), np.float32)


def photograph(
    seed: int, gains: tuple[float, float, float] = (0.5, 1.0, 0.62), height: int = 420, width: int = 560
) -> NDArray[np.uint16]:
    """Linear, grey texture seen by channels of these gains."""
    grey = 0.4 + 0.25 * texture(seed, height, width)
    return np.asarray(np.clip(grey[..., None] * np.array(gains, np.float32), 0, 1) * 60000, np.uint16)


def flat_with_noise(seed: int, spread: tuple[float, float, float]) -> NDArray[np.uint8]:
    """Coded, a slow ramp with white noise of so many levels a channel, and texture on its right half."""
    rng = np.random.default_rng(seed)
    ramp = np.linspace(60, 180, 640, dtype=np.float32)[None, :, None] + np.zeros((480, 640, 3), np.float32)
    ramp[:, 320:] += 40 * texture(seed, 480, 320)[..., None]
    noisy = ramp + rng.standard_normal(ramp.shape) * np.array(spread)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


def measured(images: list[NDArray[Any]], encoding: Encoding, weighting: str = "pixel") -> Contrast:
    contrast = Contrast(encoding)
    for image in images:
        contrast.add(image, weighting=weighting)
    return contrast


@pytest.mark.parametrize("encoding", ["coded", "linear"])
def test_neither_order_nor_grouping_shows(encoding: Encoding) -> None:
    images: list[NDArray[Any]] = [photograph(n, height=300 + 40 * n) for n in range(4)]
    if encoding == "coded":
        images = [flat_with_noise(n, (2.0, 1.0, 3.0))[: 300 + 20 * n] for n in range(4)]
    whole = measured(images, encoding)
    grouped = (images[3:1:-1], images[:1], images[1:2])
    parts = reduce(add, (measured(group, encoding) for group in grouped))
    np.testing.assert_array_equal(whole.signal, parts.signal)
    np.testing.assert_array_equal(whole.noise, parts.noise)
    assert np.linalg.eigvalsh(whole.noise)[0] > 0
    assert np.linalg.eigvalsh(whole.signal)[0] > -1e-3 * np.trace(whole.signal)


def test_the_best_triplet_is_the_eigenvector_where_that_is_a_triplet() -> None:
    contrast = measured([photograph(1), photograph(2, (0.6, 0.9, 0.5))], "linear")
    values, vectors = np.linalg.eig(np.linalg.solve(contrast.noise, contrast.signal))
    top = np.real(vectors[:, np.argmax(np.real(values))])
    top = top / top.sum()
    assert (top > 0).all()
    np.testing.assert_allclose(np.array(contrast.best(GRID)) / 100, top, atol=0.011)
    reached = contrast.snr_of(GRID).max()
    assert 0.9995 * np.real(values).max() <= reached**2 <= np.real(values).max() * (1 + 1e-9)


@pytest.mark.parametrize("gains", [(0.5, 1.0, 0.62), (0.95, 1.0, 0.33), (0.42, 1.0, 0.8)])
def test_linear_grey_detail_is_best_seen_by_adding_up_photons(gains: tuple[float, float, float]) -> None:
    """With detail and noise variance both as the gains, N^-1 v is equal in red and blue, more in green."""
    best = measured([photograph(3, gains)], "linear").best(GRID)
    expected = np.array((1, 1 / _GREEN_SHARE, 1)) / (2 + 1 / _GREEN_SHARE)
    np.testing.assert_allclose(np.array(best) / 100, expected, atol=0.015)


def test_coded_noise_is_found_beside_texture() -> None:
    """White noise keeps .0294 of its variance between Gaussians of 1 and 1.6 pixels (from their kernels)."""
    spread = (3.0, 1.5, 4.5)
    contrast = measured([flat_with_noise(n, spread) for n in range(4)], "coded")
    found = np.sqrt(np.diag(contrast.noise) / (4 * 480 * 640) / 0.0294) * 255
    # The flattest blocks are also those where the noise happens to be weak: up to two fifths less, and more of
    # the strongest.
    assert (found < 1.1 * np.array(spread)).all()
    assert (found > 0.6 * np.array(spread)).all()
    assert 1.5 < found[0] / found[1] < 2.1
    assert 2.0 < found[2] / found[1] < 3.15
    off = contrast.noise / np.sqrt(np.outer(np.diag(contrast.noise), np.diag(contrast.noise)))
    assert abs(off[0, 1]) < 0.2


def test_the_noisiest_channel_is_not_admitted() -> None:
    contrast = measured([flat_with_noise(n, (1.0, 1.0, 8.0)) for n in range(2)], "coded")
    admitted = contrast.admitted(GRID)
    assert contrast.best(GRID) in admitted
    assert len(admitted) < 0.1 * len(GRID)
    assert max(blue for _, _, blue in admitted) < 15
    snr = dict(zip(GRID, contrast.snr_of(GRID), strict=True))
    assert min(snr[t] for t in admitted) >= CLOSENESS * max(snr.values())


def test_saturated_pixels_do_not_count() -> None:
    image = photograph(5)
    burnt = image.copy()
    rng = np.random.default_rng(5)
    burnt[:210] = 65535 - rng.integers(0, 900, burnt[:210].shape)
    first, second = measured([image[210:]], "linear"), measured([burnt], "linear")
    assert abs(first.snr_of([(33, 34, 33)])[0] / second.snr_of([(33, 34, 33)])[0] - 1) < 0.05
    white = measured([np.full((64, 64, 3), 255, np.uint8)], "coded")
    assert not white.signal.any()
    assert not white.snr_of(GRID).any()
    assert len(white.admitted(GRID)) == len(GRID)


def test_the_frame_of_an_undistorted_picture_does_not_count() -> None:
    plain = flat_with_noise(8, (2.0, 2.0, 2.0))
    framed = plain.copy()
    framed[:100] = framed[:, :100] = 0
    first, second = measured([plain[100:, 100:]], "coded"), measured([framed], "coded")
    assert 0.6 < np.trace(second.signal) / np.trace(first.signal) * (380 * 540) / (480 * 640) < 1.6


def test_images_count_equally_if_asked() -> None:
    large, small = photograph(6, height=420), photograph(7, height=210)
    pixel, image = (measured([large, small], "linear", weighting) for weighting in ("pixel", "image"))
    alone = [measured([i], "linear", "image").signal for i in (large, small)]
    np.testing.assert_allclose(image.signal, alone[0] + alone[1])
    weighed = (2 * alone[0] + alone[1]) / 2 * (420 * 560) / (1 << 24)
    np.testing.assert_allclose(pixel.signal, weighed, rtol=1e-4)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (7, 9), (33, 40), (161, 3000), (3000, 161)])
def test_any_size_is_measured_or_left_out(height: int, width: int) -> None:
    contrast = measured([np.full((height, width, 3), 90, np.uint8)], "coded")
    assert np.isfinite(contrast.noise).all()
    assert not contrast.signal.any()


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="dtype"):
        Contrast("linear").add(np.zeros((20, 20, 3), np.uint8))
    with pytest.raises(ValueError, match="do not add"):
        Contrast("linear") + Contrast("coded")


def test_rec709_stays_where_no_triplet_is_clearly_better() -> None:
    """Noise that makes Rec.709 itself the best: weights as of w'Nw least, so N is diagonal with 1/w."""
    contrast = Contrast("coded")
    contrast.signal = np.ones((3, 3))
    contrast.noise = np.diag(1 / np.array(FIXED["rec709"]))
    assert contrast.best(GRID) == contrast.admitted(GRID)[0] == (21, 72, 7)
    contrast.noise = np.diag((1 / 0.30, 1 / 0.55, 1 / 0.15))  # Rec.709 has .97 of the best
    share = contrast.snr_of([(21, 72, 7)])[0] / contrast.snr_of(GRID).max()
    assert (len(contrast.admitted(GRID)) == 1) == (share >= DEFAULT_ENOUGH)
    contrast.noise = np.diag((3.0, 3.0, 3.0))
    assert (21, 72, 7) not in contrast.admitted(GRID)
    assert (33, 33, 34) in contrast.admitted(GRID)


def test_greyscale_photographs_say_nothing_of_weights() -> None:
    rng = np.random.default_rng(3)
    grey = np.repeat(rng.integers(0, 256, (300, 400, 1), np.uint8), 3, axis=2)
    contrast = measured([grey], "coded")
    assert not contrast.signal.any()
    assert contrast.admitted(GRID) == list(GRID)
    assert contrast.best(GRID) == (21, 72, 7)
