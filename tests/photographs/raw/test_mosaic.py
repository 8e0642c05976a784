"""The steps on the mosaic, each against what it undoes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.photographs.raw.mosaic import Frames, Mosaic, calibrated, green_gains, repair

BAYER = np.array([[0, 1], [3, 2]], np.uint8)
SHAPE = (200, 302)
BLACK, WHITE = 500.0, 16000.0


def scene(seed: int = 0) -> NDArray[np.float64]:
    """Light in 0..0.9, smooth."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    return np.asarray(0.45 + 0.3 * np.sin(x / 50 + seed) + 0.15 * np.cos(y / 30))


def mosaic_of(share: NDArray[np.float64], black: NDArray[np.float32] | None = None) -> Mosaic:
    cell = np.full((2, 2), BLACK, np.float32) if black is None else black
    values = np.clip(np.rint(share * (WHITE - BLACK) + BLACK), 0, 65535)
    return Mosaic(values.astype(np.uint16), BAYER, cell, WHITE)


def shares(values: NDArray[np.uint16]) -> NDArray[np.float64]:
    return np.asarray(values / 65535)


def plain(mosaic: Mosaic, frames: Frames | None = None, green: bool = False) -> NDArray[np.uint16]:
    return calibrated(mosaic, frames or Frames(), green_equilibrium=green)


def test_black_to_next_to_nothing_and_saturation_to_65535() -> None:
    values = plain(mosaic_of(np.linspace(-0.02, 1.2, SHAPE[0] * SHAPE[1]).reshape(SHAPE)))
    assert values.min() == 1
    assert values.max() == 65535
    np.testing.assert_allclose(shares(plain(mosaic_of(scene()))), scene(), atol=1e-4)


def test_it_may_write_over_what_it_reads() -> None:
    expected = plain(mosaic_of(scene()), green=True)
    mosaic = mosaic_of(scene())
    found = calibrated(mosaic, Frames(), green_equilibrium=True, out=mosaic.values)
    assert found is mosaic.values
    np.testing.assert_array_equal(found, expected)


def test_a_dark_frame_takes_its_pattern_away() -> None:
    rng = np.random.default_rng(1)
    glow = rng.uniform(0, 300, SHAPE)
    clean = scene() * (WHITE - BLACK)
    mosaic = replace(mosaic_of(scene()), values=np.rint(clean + BLACK + glow).astype(np.uint16))
    dark = (BLACK + glow).astype(np.float32)
    np.testing.assert_allclose(shares(plain(mosaic, Frames(dark=dark))), scene(), atol=1e-4)
    assert np.abs(shares(plain(mosaic)) - scene()).max() > 0.015


def test_a_flat_field_evens_the_response_out() -> None:
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    falloff = 1 - 0.5 * ((x / SHAPE[1] - 0.5) ** 2 + (y / SHAPE[0] - 0.5) ** 2)
    gain = (1 / falloff).astype(np.float32)
    np.testing.assert_allclose(
        shares(plain(mosaic_of(scene() * falloff), Frames(flat=gain))), scene(), atol=2e-4
    )
    assert (plain(mosaic_of(np.full(SHAPE, 1.1)), Frames(flat=1 / gain)) == 65535).all()  # still saturated


def test_frames_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match="flat"):
        plain(mosaic_of(scene()), Frames(flat=np.ones((3, 3), np.float32)))


def test_bad_pixels_get_what_is_around_them() -> None:
    mosaic = mosaic_of(scene())
    rng = np.random.default_rng(2)
    bad = np.unique(rng.integers(0, SHAPE, (300, 2)), axis=0)
    cluster = np.argwhere(np.ones((4, 4), bool)) + np.array((100, 100))
    bad = np.concatenate([bad, cluster, [[0, 0], [SHAPE[0] - 1, SHAPE[1] - 1], [-1, 5], [5, 9999]]])
    inside = bad[(bad >= 0).all(axis=1) & (bad < SHAPE).all(axis=1)]
    mosaic.values[inside[:, 0], inside[:, 1]] = 16000
    found = shares(plain(mosaic, Frames(bad=bad)))
    np.testing.assert_allclose(found, scene(), atol=0.03)


def test_a_bad_pixel_alone_in_its_colour_stays() -> None:
    values = np.full((2, 2), 7, np.uint16)
    repair(values, BAYER, np.array([[0, 0]]))
    assert (values == 7).all()


@pytest.mark.parametrize("ratio", [0.97, 1.0, 1.06])
def test_greens_are_brought_level_and_red_and_blue_left_alone(ratio: float) -> None:
    share = scene().copy()
    share[1::2, 0::2] *= ratio
    values = shares(plain(mosaic_of(share), green=True))
    middle = (1 + ratio) / 2
    np.testing.assert_allclose(values[0::2, 1::2], scene()[0::2, 1::2] * middle, atol=1e-3)
    np.testing.assert_allclose(values[1::2, 0::2], scene()[1::2, 0::2] * middle, atol=1e-3)
    np.testing.assert_allclose(values[0::2, 0::2], scene()[0::2, 0::2], atol=1e-4)
    np.testing.assert_allclose(values[1::2, 1::2], scene()[1::2, 1::2], atol=1e-4)


def test_what_is_saturated_is_level_whatever_green_equilibrium_and_black_say() -> None:
    share = scene().copy()
    share[1::2, 0::2] *= 1.06
    share[:60] = 1.5
    black = np.array([[BLACK, BLACK + 40], [BLACK + 80, BLACK]], np.float32)
    mosaic = mosaic_of(np.minimum(share, 1), black)
    assert (plain(mosaic, green=True)[:60] == 65535).all()
    assert (plain(mosaic, green=True)[70:] < 65535).all()


def test_a_texture_of_the_scene_is_not_taken_for_the_sensors() -> None:
    share = scene().copy()
    share[1:80:2, 0:120:2] *= 0.5  # fine stripes on a sixth of the picture
    assert np.abs(green_gains(mosaic_of(share), Frames()) - 1).max() < 2e-3
    share[1::2, 0::2] *= 0.5  # no two greens of one sensor are this far apart
    assert (green_gains(mosaic_of(share), Frames()) == 1).all()


def test_without_two_greens_there_is_nothing_to_level() -> None:
    mono = replace(mosaic_of(scene(), np.full((1, 1), BLACK, np.float32)), pattern=np.zeros((1, 1), np.uint8))
    np.testing.assert_allclose(shares(plain(mono, green=True)), scene(), atol=1e-4)
