"""Linear TIFFs: what they say of their colours, and that they are read as they were written."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.photographs.linear_tiff import encode_linear_tiff, sensor_colours
from colmap_ihe.pipeline.convert_folder import convert_folder
from colmap_ihe.pipeline.develop_folder import develop_folder

MATRIX = np.array(((1.661, -0.579, -0.082), (-0.14, 1.557, -0.417), (0.009, -0.457, 1.448)))


def test_balance_and_matrix_come_back() -> None:
    balance = (2.397, 1.0, 1.4)
    encoded = encode_linear_tiff(np.zeros((4, 6, 3), np.uint16), b"", MATRIX @ np.diag(balance))
    with Image.open(BytesIO(encoded)) as image:
        colours = sensor_colours(image.tag_v2)  # type: ignore[attr-defined]
    assert colours is not None
    assert colours.white_balance == pytest.approx(balance, rel=1e-4)
    np.testing.assert_allclose(colours.srgb_from_balanced, MATRIX, atol=2e-4)
    np.testing.assert_allclose(colours.srgb_from_camera((1.0, 1.0, 1.0)), MATRIX, atol=2e-4)


@pytest.mark.parametrize(
    "tags", [{}, {50721: (1.0,) * 9, 50728: (1.0,) * 3}, {50721: (1.0,) * 4, 50728: "x"}]
)
def test_tags_that_say_nothing_of_use(tags: dict[int, object]) -> None:
    assert sensor_colours(tags) is None


def pixels(folder: Path) -> dict[str, NDArray[np.uint8]]:
    return {p.stem: np.asarray(Image.open(p)) for p in folder.glob("*.png")}


def test_what_develop_wrote_becomes_the_same_grey_and_colour_as_the_raw(
    small_demo: Path, tmp_path: Path
) -> None:
    (tmp_path / "raw").mkdir()
    for number in (1, 2):
        name = f"portico_{number:02}.dng"
        (tmp_path / "raw" / name).write_bytes((small_demo / "images" / name).read_bytes())
    develop_folder(tmp_path / "raw", tmp_path / "linear")
    greys = {}
    for kind in ("raw", "linear"):
        folders = tmp_path / f"{kind} grey", tmp_path / f"{kind} colour"
        grey, _, _ = convert_folder(tmp_path / kind, folders[0], colour=folders[1])
        assert grey.encoding == "linear"
        greys[kind] = pixels(folders[0])
        twins, expected = pixels(folders[1]), pixels(tmp_path / "raw colour")
        for name, twin in twins.items():
            assert np.abs(twin.astype(int) - expected[name]).max() <= 1
    for name, grey_pixels in greys["raw"].items():
        np.testing.assert_array_equal(greys["linear"][name], grey_pixels)


def test_a_tiff_of_16_bit_without_these_tags_is_coded(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    rng = np.random.default_rng(1)
    tifffile.imwrite(tmp_path / "images/a.tif", rng.integers(0, 65536, (80, 90, 3), np.uint16))
    grey, _, _ = convert_folder(tmp_path / "images", tmp_path / "grey")
    assert grey.encoding == "coded"
