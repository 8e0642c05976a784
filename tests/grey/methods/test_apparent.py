"""Apparent greyscale: its lightness against colour-science pixel by pixel, its masking against the paper's form."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import cv2
import numpy as np
import pytest
from oracle import photograph

from colmap_ihe.errors import CapabilityError
from colmap_ihe.grey import srgb
from colmap_ihe.grey.methods import apparent as room

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    colour: Any = pytest.importorskip("colour", reason="colour-science is not installed")


def test_lightness_is_that_of_colour_science_within_what_the_docstring_says() -> None:
    steps = np.linspace(0, 1, 35)  # in one row, wider than OpenCV takes
    rgb = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(1, -1, 3)
    xyz = colour.models.eotf_sRGB(rgb) @ srgb.XYZ_FROM_RGB.T
    white = srgb.WHITE
    star = colour.XYZ_to_Lab(xyz, colour.XYZ_to_xy(white))[..., 0]
    bright = star > 0
    uv = colour.xy_to_Luv_uv(colour.XYZ_to_xy(xyz[bright]))
    effect = colour.HelmholtzKohlrausch_effect_object_Nayatani1997(
        uv, colour.xy_to_Luv_uv(colour.XYZ_to_xy(white)), 20.0, method="VCC"
    )
    found = room.apparent_lightness(rgb.astype(np.float32))
    assert np.abs(found[bright] - effect * star[bright]).max() < 0.02
    assert not found[~bright].any()
    assert found.max() < 100.01
    assert (effect * star[bright] - star[bright]).max() > 5  # there is an effect to be off by


def test_masking_is_the_sum_of_the_papers_gains_times_bands() -> None:
    image = photograph(1, 61, 90)
    grey = room.apparent_lightness(image)
    planes = [grey, *np.moveaxis(srgb.lab(image), -1, 0)]
    expected = grey.astype(np.float64)
    sizes: list[Any] = []
    for _ in range(4):
        bands, smaller = [], []
        for plane in planes:
            down: Any = cv2.pyrDown(np.ascontiguousarray(plane))
            bands.append(plane - cv2.pyrUp(down, dstsize=plane.shape[::-1]))
            smaller.append(down)
        contrast = np.sqrt(bands[1] ** 2 + bands[2] ** 2 + bands[3] ** 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = (contrast / np.abs(bands[0])) ** 0.5
            part: Any = np.where(bands[0] == 0, 0, 0.5 * gain * bands[0]).astype(np.float32)
        for size in reversed(sizes):
            part = cv2.pyrUp(part, dstsize=size)
        expected += part
        sizes.append(planes[0].shape[::-1])
        planes = smaller
    wanted = srgb.grey_of_lightness(expected.astype(np.float32))
    np.testing.assert_allclose(room.apparent(image), wanted, atol=1e-4)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 3), (40, 50)])
def test_a_flat_photograph_is_its_apparent_lightness(size: tuple[int, int]) -> None:
    image = np.full((*size, 3), (0.7, 0.2, 0.4), np.float32)
    expected = srgb.grey_of_lightness(room.apparent_lightness(image))
    np.testing.assert_allclose(room.apparent(image), expected, atol=1e-4)
    neutral = np.full((*size, 3), 0.6, np.float32)
    np.testing.assert_allclose(room.apparent(neutral), 0.6, atol=1e-3)


def test_without_colour_science_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "colour", None)
    room._effect.cache_clear()
    with pytest.raises(CapabilityError, match="colour-science") as caught:
        room.apparent(np.zeros((4, 4, 3), np.float32))
    assert caught.value.hint == "in the clone of colmap-ihe: pip install '.[conversions]'"
