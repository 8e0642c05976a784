"""Luminance and value, and the colour spaces beneath: against published colours and the package colour-science."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from colmap_ihe.grey import srgb
from colmap_ihe.grey.methods.luminance import cie_y, value

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    colour: Any = pytest.importorskip("colour", reason="colour-science is not installed")

COLOURS = np.random.default_rng(1).random((40, 50, 3), np.float32)


def test_cie_y_is_the_luminance_of_the_standard_coded_again() -> None:
    light = colour.models.eotf_sRGB(COLOURS.astype(np.float64))
    expected = colour.models.eotf_inverse_sRGB(light @ [0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(cie_y(COLOURS), expected, atol=1e-5)


def test_value_is_the_greatest_channel() -> None:
    np.testing.assert_array_equal(value(COLOURS), COLOURS.max(axis=2))


def test_lab_is_that_of_colour_science() -> None:
    white = colour.XYZ_to_xy(srgb.WHITE)
    light = colour.models.eotf_sRGB(COLOURS.astype(np.float64))
    expected = colour.XYZ_to_Lab(light @ srgb.XYZ_FROM_RGB.T, white)
    np.testing.assert_allclose(srgb.lab(COLOURS), expected, atol=2e-3)


def test_coding_and_lightness_come_back() -> None:
    grey = np.linspace(0, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(srgb.coded(srgb.linear(grey)), grey, atol=1e-6)
    np.testing.assert_allclose(srgb.grey_of_lightness(srgb.lightness(srgb.linear(grey))), grey, atol=1e-5)


@pytest.mark.parametrize("height", [1, 3, 700])
def test_bands_cover_every_row_once(height: int) -> None:
    rows = np.zeros(height, np.int64)
    for band in srgb.bands(np.zeros((height, 1000, 3), np.float32)):
        rows[band] += 1
    assert (rows == 1).all()
