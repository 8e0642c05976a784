"""Gains to the nearest whole value, and denoising that takes noise and leaves the picture."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.errors import CapabilityError
from colmap_ihe.photographs.adjust import prepared
from colmap_ihe.photographs.raw import denoise
from colmap_ihe.photographs.raw.denoise import denoised, noise_of
from colmap_ihe.pipeline.stages import captures
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import load_options
from colmap_ihe.project.recipe import Recipe

pytest.importorskip("pywt", reason="denoising needs PyWavelets: pip install '.[denoise]'")

SIZE = (300, 340)
WELL_E = 2000.0
SMOOTH, BOARD = np.s_[:, :165], np.s_[:, 175:]


def scene() -> NDArray[np.float64]:
    """(300, 340, 3) in 0..1: smooth colours left, and right a board of 12 pixels a field."""
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    smooth = 0.35 + 0.2 * np.sin(x / 60) * np.cos(y / 50)
    board = np.where((x // 12 + y // 12) % 2, 0.15, 0.45)
    return np.asarray(np.where(x < 170, smooth, board)[..., None] * (0.8, 1.0, 0.6))


def photons(seed: int = 0) -> NDArray[np.uint16]:
    """The scene as a linear photograph of 2,000 electrons at saturation."""
    counted = np.random.default_rng(seed).poisson(scene() * WELL_E) / WELL_E
    return np.asarray(np.rint(np.minimum(counted, 1) * 65535), np.uint16)


def coded(sigma: float) -> NDArray[np.uint8]:
    noisy = 255 * np.sqrt(scene()) + np.random.default_rng(1).normal(0, sigma, (*SIZE, 3))
    return np.rint(np.clip(noisy, 0, 255)).astype(np.uint8)


def rms(a: NDArray[Any], b: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean((a.astype(np.float64) - b) ** 2)))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_gains_multiply_to_the_nearest_value_and_stop_at_the_end(dtype: Any) -> None:
    rgb = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (40, 50, 3), dtype, endpoint=True)
    gains = (0.37, 1.0, 1.9)
    found = prepared(rgb, Recipe(gains=gains))
    exact = np.minimum(rgb.astype(np.float64) * gains, np.iinfo(dtype).max)
    assert found.dtype == dtype
    assert np.abs(found - exact).max() <= 0.5 + 1e-6
    np.testing.assert_array_equal(found[..., 1], rgb[..., 1])


def test_a_plain_recipe_leaves_the_array_as_it_is() -> None:
    rgb = np.zeros((8, 9, 3), np.uint16)
    assert prepared(rgb, Recipe()) is rgb
    assert prepared(rgb, Recipe(dark="calibration/dark.dng")) is rgb


@pytest.mark.parametrize("gains", [(1, 0, 1), (1, -1, 1), (1, np.nan, 1), (1, np.inf, 1), (1, 2)])
def test_gains_that_are_none_are_refused(gains: Any) -> None:
    with pytest.raises(ValueError, match="expected three positive numbers"):
        prepared(np.zeros((8, 9, 3), np.uint16), Recipe(gains=gains))


@pytest.mark.parametrize(
    "rgb", [np.zeros((8, 9), np.uint8), np.zeros((8, 9, 3)), np.zeros((8, 9, 4), np.uint8)]
)
def test_another_shape_or_dtype_is_refused_with_what_came(rgb: Any) -> None:
    with pytest.raises(ValueError, match=r"rgb\.shape=.*expected \(H, W, 3\)"):
        prepared(rgb, Recipe(gains=(2, 2, 2)))


def test_gains_come_before_denoising() -> None:
    rgb = photons()
    both = prepared(rgb, Recipe(gains=(0.5, 0.8, 1.0), denoise=1.0))
    one = prepared(prepared(rgb, Recipe(gains=(0.5, 0.8, 1.0))), Recipe(denoise=1.0))
    np.testing.assert_array_equal(both, one)


@pytest.mark.parametrize("sigma", [2.0, 5.0, 12.0])
def test_noise_is_found_beside_detail(sigma: float) -> None:
    found = noise_of(np.asarray(coded(sigma), np.uint16) * np.uint16(257)) / 257
    np.testing.assert_allclose(found, np.hypot(sigma, 12**-0.5), rtol=0.15)


def test_of_flat_black_and_clipped_pictures_no_noise_is_known() -> None:
    for value in (0, 30000, 65535):
        rgb = np.full((100, 100, 3), value, np.uint16)
        assert not noise_of(rgb).any()
        assert denoised(rgb, 1.0) is rgb
    assert not noise_of(np.zeros((5, 7, 3), np.uint16)).any()


@pytest.mark.parametrize(
    ("noisy", "truth"), [(photons(), scene() * 65535), (coded(6.0), 255 * np.sqrt(scene()))]
)
def test_noise_shrinks_and_means_and_edges_stay(noisy: NDArray[Any], truth: NDArray[np.float64]) -> None:
    clean = denoised(noisy, 1.0)
    assert clean.dtype == noisy.dtype
    for part, share in ((SMOOTH, 0.8), (BOARD, 0.95)):
        assert rms(clean[part], truth[part]) < share * rms(noisy[part], truth[part])
        np.testing.assert_allclose(clean[part].mean((0, 1)), noisy[part].mean((0, 1)), rtol=0.003)
    assert abs(clean.mean() / noisy.mean() - 1) < 7e-4


@pytest.mark.parametrize("size", [(64, 64), (65, 71), (130, 67)])
def test_sizes_that_no_wavelet_divides(size: tuple[int, int]) -> None:
    noisy = np.ascontiguousarray(coded(6.0)[: size[0], : size[1]])
    clean = denoised(noisy, 1.0)
    assert clean.shape == noisy.shape
    assert 0 < rms(clean, noisy) < 12


def test_subbands_are_thresholded_as_bayes_shrink_has_it() -> None:
    """Detail of variance 9 and noise of 4, threshold 4 / 3."""
    band = np.random.default_rng(0).normal(0, 13**0.5, (400, 400)).astype(np.float32)
    found = denoise._thresholded(band, 4.0)
    threshold = 4 / np.sqrt(np.mean(band.astype(np.float64) ** 2) - 4)
    assert threshold == pytest.approx(4 / 3, rel=0.01)
    expected = np.where(np.abs(band) > threshold, band - np.sign(band) * threshold, 0)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert not denoise._thresholded(band, 14.0).any()


def test_without_its_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pywt", None)
    with pytest.raises(CapabilityError, match="PyWavelets") as caught:
        denoised(photons(), 1.0)
    assert "denoise" in caught.value.hint
    with pytest.raises(CapabilityError, match="PyWavelets"):
        captures.STAGE.check(load_options(None, ["develop.denoise=1.5"]), 3)
    captures.STAGE.check(Options(), 3)


def test_more_strength_is_smoother_and_none_is_the_same_array() -> None:
    noisy = photons()
    assert denoised(noisy, 0.0) is noisy
    changes = [rms(denoised(noisy, strength), noisy) for strength in (0.25, 0.5, 1.0, 2.0)]
    assert changes == sorted(changes)


def test_runs_make_no_difference_and_strips_next_to_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A strip finds its own thresholds, so where it ends shows in far less than the noise."""
    noisy = photons()
    whole = denoised(noisy, 1.0)
    np.testing.assert_array_equal(denoised(noisy, 1.0), whole)
    monkeypatch.setattr(denoise, "_STRIP", 64)
    assert rms(denoised(noisy, 1.0), whole) < 0.05 * rms(noisy, whole)
