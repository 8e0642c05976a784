"""Every kind of sensor, as a DNG of that kind: the scene comes back linear and in the sensor's own colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dngs import GAINS, XTRANS, light, write_kind
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError
from colmap_ihe.photographs.raw.develop import develop, read_header, read_mosaic

HEIGHT, WIDTH = 96, 144
LIGHT = light(HEIGHT, WIDTH)
RGGB = np.array([list("RG"), list("GB")])


def seen(pattern: NDArray[Any]) -> NDArray[np.float64]:
    """What a sensor of this pattern sees of grey light, as a share of saturation."""
    n, m = pattern.shape
    gains = np.vectorize(GAINS.get)(pattern)
    return np.asarray(LIGHT * np.tile(gains, (HEIGHT // n + 1, WIDTH // m + 1))[:HEIGHT, :WIDTH])


def counts(share: NDArray[np.float64], black: Any, white: int) -> NDArray[np.uint16]:
    return np.asarray(np.rint(share * (white - np.min(black)) + black), np.uint16)


def shot(folder: Path, values: NDArray[np.uint16], **kind: Any) -> Path:
    usual: dict[str, Any] = {"pattern": RGGB, "white": 15200, "black": (200,)}
    write_kind(folder / "a.dng", values, **(usual | kind))
    return folder / "a.dng"


def require_scene(file: Path, tolerance: float = 2e-3) -> None:
    gains = tuple(GAINS.values())
    rgb = develop(file).linear_rgb[6:-6, 6:-6] / 65535
    truth = LIGHT[6:-6, 6:-6, None] * gains
    np.testing.assert_allclose(rgb, truth, rtol=tolerance)
    ratios = np.median(rgb / rgb[..., 1:2], axis=(0, 1))
    np.testing.assert_allclose(ratios, np.array(gains) / gains[1], rtol=1e-3)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_a_bayer_sensor_of_10_to_16_bits(tmp_path: Path, bits: int) -> None:
    white = (1 << bits) - 1
    file = shot(tmp_path, counts(seen(RGGB), 64, white), bits=bits, white=None, black=(64,))
    assert read_header(file).sensor == "bayer"
    require_scene(file, 3 * 2.0**-bits * 4 + 1e-3)


@pytest.mark.parametrize("turn", range(4))
def test_a_bayer_sensor_of_any_phase(tmp_path: Path, turn: int) -> None:
    pattern = np.roll(RGGB, (turn // 2, turn % 2), axis=(0, 1))
    require_scene(shot(tmp_path, counts(seen(pattern), 200, 16000), pattern=pattern, white=16000))


def test_an_x_trans_sensor(tmp_path: Path) -> None:
    file = shot(tmp_path, counts(seen(XTRANS), 300, 16300), pattern=XTRANS, white=16300, black=(300,))
    assert read_header(file).sensor == "x-trans"
    require_scene(file, 0.02)


def test_a_file_that_is_demosaiced_already(tmp_path: Path) -> None:
    values = counts(LIGHT[..., None] * tuple(GAINS.values()), np.array((100, 120, 140)), 60000)
    file = shot(tmp_path, values, pattern=None, white=60000, black=(100, 120, 140))
    assert read_header(file).sensor == "demosaiced"
    require_scene(file, 1e-3)
    with pytest.raises(PhotographError, match=r"a\.dng: is demosaiced already"):
        read_mosaic(file)


def test_a_monochrome_sensor_gives_three_equal_channels(tmp_path: Path) -> None:
    file = shot(tmp_path, counts(LIGHT, 100, 60000), pattern=None, white=60000, black=(100,))
    assert read_header(file).sensor == "monochrome"
    rgb = develop(file).linear_rgb
    assert (rgb == rgb[..., :1]).all()
    np.testing.assert_allclose(rgb[..., 0] / 65535, LIGHT, rtol=1e-3)


def test_black_that_differs_by_place_in_the_cell(tmp_path: Path) -> None:
    black = np.array([[200, 210], [220, 260]])
    values = counts(seen(RGGB), np.tile(black, (HEIGHT // 2, WIDTH // 2)), 15200)
    require_scene(shot(tmp_path, values, black=tuple(black.ravel()), repeat=(2, 2)))


@pytest.mark.parametrize("repeat", [(4, 4), (2, 4), (4, 2)])
def test_black_that_repeats_in_a_larger_cell_than_the_colours(
    tmp_path: Path, repeat: tuple[int, int]
) -> None:
    black = 800.0 + 30 * np.arange(repeat[0] * repeat[1]).reshape(repeat)
    tiled = np.tile(black, (HEIGHT // repeat[0], WIDTH // repeat[1]))
    values = np.rint(seen(RGGB) * 14200 + tiled).astype(np.uint16)
    require_scene(shot(tmp_path, values, white=15000, black=tuple(black.ravel()), repeat=repeat))


def test_black_that_is_no_whole_number(tmp_path: Path) -> None:
    """Within half a level of the sensor, where LibRaw takes 1000.9 for 1000."""
    values = np.full((HEIGHT, WIDTH), 2000, np.uint16)
    rgb = develop(shot(tmp_path, values, white=15000, black=(1000.9,))).linear_rgb
    np.testing.assert_allclose(rgb[6:-6, 6:-6], 65535 * 999.1 / 13999.1, atol=1)


def test_black_that_differs_by_row_and_column(tmp_path: Path) -> None:
    across, down = np.linspace(0, 80, WIDTH).round(2), np.linspace(0, 40, HEIGHT).round(2)
    values = np.rint(seen(RGGB) * 15000 + 200 + across[None] + down[:, None]).astype(np.uint16)
    require_scene(shot(tmp_path, values, delta_h=across, delta_v=down))


def test_masked_borders_are_not_in_the_picture(tmp_path: Path) -> None:
    values = np.full((HEIGHT + 7, WIDTH + 12), 3, np.uint16)
    values[4:-3, 8:-4] = counts(seen(RGGB), 200, 15200)
    file = shot(tmp_path, values, active=(4, 8, HEIGHT + 4, WIDTH + 8))
    header = read_header(file)
    assert (header.width, header.height) == (WIDTH, HEIGHT)
    require_scene(file)


def test_a_pixel_that_the_camera_marked_is_guessed(tmp_path: Path) -> None:
    values = counts(seen(RGGB), 200, 15200)
    values[40, 60] = values[41, 61] = 0
    require_scene(shot(tmp_path, values), 0.03)
