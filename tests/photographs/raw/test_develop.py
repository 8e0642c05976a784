"""Minimal development on DNGs of known scenes: linear, the sensor's own colours, nothing else."""

from __future__ import annotations

import struct
from pathlib import Path

import dngs
import numpy as np
import pytest
from dngs import GAINS, light
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError
from colmap_ihe.photographs.raw.develop import develop, preview_of, read_header, read_mosaic

BLACK, WHITE = 512, 16383
MATRIX = np.array(((0.9, -0.3, -0.1), (-0.4, 1.3, 0.1), (0.0, 0.2, 0.6)))
HEIGHT, WIDTH = 96, 128
LIGHT = light(HEIGHT, WIDTH)


def shoot(
    file: Path, exposure: float = 1.0, pattern: str = "RGGB", black: int = BLACK, orientation: int = 1
) -> None:
    """A noiseless grey scene seen through a sensor of unequal gains."""
    mosaic = LIGHT * exposure
    for n, colour in enumerate(pattern):
        mosaic[n // 2 :: 2, n % 2 :: 2] *= GAINS[colour]
    values = np.clip(np.rint(mosaic * (WHITE - black) + black), 0, WHITE).astype(np.uint16)
    colours = {"as_shot_neutral": tuple(GAINS.values()), "colour_matrix": MATRIX, "pattern": pattern}
    dngs.shoot(file, values, black=black, orientation=orientation, **colours)


def overwrite(file: Path, entry: bytes, value: bytes) -> None:
    """Give another value to the tag whose entry in the directory begins like this."""
    content = file.read_bytes()
    place = content.index(entry) + len(entry)
    file.write_bytes(content[:place] + value + content[place + len(value) :])


def developed(file: Path) -> NDArray[np.float64]:
    """Shares of saturation, without the border, where demosaicing has fewer neighbours."""
    rgb = develop(file).linear_rgb
    assert rgb.dtype == np.uint16
    assert rgb.shape == (HEIGHT, WIDTH, 3)
    return rgb[4:-4, 4:-4].astype(np.float64) / 65535


@pytest.mark.parametrize("black", [0, 64, BLACK, 2056])
def test_values_are_proportional_to_exposure(tmp_path: Path, black: int) -> None:
    shoot(tmp_path / "full.dng", 1.0, black=black)
    shoot(tmp_path / "quarter.dng", 0.25, black=black)
    ratio = developed(tmp_path / "full.dng") / developed(tmp_path / "quarter.dng")
    assert np.median(ratio) == pytest.approx(4, rel=1e-3)
    assert 3.9 < np.percentile(ratio, 1) < np.percentile(ratio, 99) < 4.1


def test_saturation_is_65535_and_black_is_next_to_nothing(tmp_path: Path) -> None:
    shoot(tmp_path / "over.dng", 20)
    assert (developed(tmp_path / "over.dng") == 1).all()
    shoot(tmp_path / "dark.dng", 0)
    assert (developed(tmp_path / "dark.dng") == 1 / 65535).all()  # LibRaw takes 0 for a defect


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_the_sensors_orientation_is_kept(tmp_path: Path, orientation: int) -> None:
    shoot(tmp_path / "upright.dng")
    shoot(tmp_path / "turned.dng", orientation=orientation)
    np.testing.assert_array_equal(
        develop(tmp_path / "turned.dng").linear_rgb, develop(tmp_path / "upright.dng").linear_rgb
    )
    header = read_header(tmp_path / "turned.dng")
    assert (header.width, header.height, header.sensor) == (WIDTH, HEIGHT, "bayer")


def test_camera_white_becomes_white_in_the_colour_twin(tmp_path: Path) -> None:
    shoot(tmp_path / "a.dng")
    matrix = develop(tmp_path / "a.dng").srgb_from_camera
    np.testing.assert_allclose(matrix @ np.array(list(GAINS.values())) / GAINS["G"], [1, 1, 1], rtol=2e-3)


def test_white_not_above_black_is_refused(tmp_path: Path) -> None:
    shoot(tmp_path / "a.dng")
    overwrite(tmp_path / "a.dng", struct.pack("<HHI", 50717, 4, 1), struct.pack("<I", BLACK))
    with pytest.raises(PhotographError, match=r"a\.dng: white level"):
        develop(tmp_path / "a.dng")


def test_a_raw_without_preview_has_none(tmp_path: Path) -> None:
    shoot(tmp_path / "a.dng")
    assert preview_of(tmp_path / "a.dng") == b""


@pytest.mark.data
@pytest.mark.parametrize("name", ["colorchart.dng", "kodak_dc50.kdc"])
def test_real_raw_files(photographs: Path, name: str) -> None:
    file = photographs / "raw" / name
    found = develop(file)
    header = read_header(file)
    assert found.linear_rgb.shape[:2] == (header.height, header.width)
    assert found.linear_rgb.max() > 20_000
    assert np.isfinite(found.srgb_from_camera).all()
    medians = np.median(found.linear_rgb.reshape(-1, 3), axis=0) / 65535
    assert (medians > 0.003).all()
    assert (medians < 0.8).all()


def test_pixels_that_libraw_passes_over_are_not_taken_from_memory(tmp_path: Path) -> None:
    """A DNG whose data are not the lossless JPEG that its header says: LibRaw raises nothing, and says nothing."""
    file = tmp_path / "a.dng"
    shoot(file)
    overwrite(file, struct.pack("<HHI", 259, 3, 1), struct.pack("<H", 7))
    for read in (develop, read_mosaic):
        with pytest.raises(PhotographError, match=r"a\.dng: 100\.0% of its pixels cannot be decoded"):
            read(file)
