"""An image made as if it had been doubled has COLMAP's features of the doubled one, in its own resolution."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.colmap.array_features import extract_arrays
from colmap_ihe.colmap.extraction import extraction_options
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.colmap.own_resolution import VARIANCE, as_doubled, rounded, taps_of, write_as_doubled
from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.project.options import FeaturesOptions


def texture() -> NDArray[np.uint8]:
    """Return a grey image of detail of 1 to 4 pixels."""
    draw = np.random.default_rng(3)
    layers = [
        cv2.GaussianBlur(draw.normal(0, 1, (240, 320)), (0, 0), size) * size for size in (1, 1.5, 2.5, 4)
    ]
    return np.clip(128 + 22 * sum(layers), 0, 255).astype(np.uint8)


def places_of(image: NDArray[np.uint8], first_octave: int, cap: int) -> NDArray[np.float32]:
    options = extraction_options(FeaturesOptions())
    options.sift.first_octave, options.sift.num_octaves = first_octave, 3 - first_octave
    options.sift.max_num_features = cap
    with quiet():
        ((keypoints, _),) = extract_arrays([image], options, "a test")
    return np.unique(keypoints[:, :2], axis=0)


def test_features_are_colmaps_of_the_doubled_image() -> None:
    image = texture()
    cap = len(places_of(as_doubled(image), 0, 10_000)) - 20  # of which the doubled image has no feature
    whole, made, plain = (
        places_of(given, first, cap) for given, first in ((image, -1), (as_doubled(image), 0), (image, 0))
    )
    assert len(made) == pytest.approx(len(whole), rel=0.02)
    assert share_within(whole, made, 0.05) > 0.9
    assert share_within(whole, plain, 0.05) < 0.8


def share_within(places: NDArray[np.float32], others: NDArray[np.float32], pixels: float) -> float:
    """Return the share of places, (N, 2), that have one of the others near them."""
    return float(np.mean([np.abs(others - place).max(axis=1).min() < pixels for place in places]))


@pytest.mark.parametrize("variance", [VARIANCE, 0.5, 2.3])
def test_taps_have_the_variance(variance: float) -> None:
    taps = taps_of(variance)
    offsets = np.arange(len(taps)) - len(taps) // 2
    assert taps.sum() == pytest.approx(1)
    assert (taps * offsets**2).sum() == pytest.approx(variance)
    assert (taps >= 0).all()


def test_the_blur_is_of_the_pixels_that_colmap_looks_at() -> None:
    image = np.zeros((9, 9), np.uint8)
    image[4, 4] = 196  # 168 of it stay in the row, as 1, 12 and 1 of 14
    assert as_doubled(image)[4].tolist() == [0, 0, 0, 12, 144, 12, 0, 0, 0]
    # 9 / 56, 38 / 56 and 9 / 56 of 133: 21.4, 90.3 and 21.4
    assert as_doubled(image, 1.5)[4].tolist() == [0, 0, 0, 21, 91, 21, 0, 0, 0]


def test_errors_of_rounding_are_gone_where_an_image_is_smooth() -> None:
    levels = cv2.GaussianBlur(np.random.default_rng(1).uniform(60, 190, (80, 90)), (0, 0), 2).astype(
        np.float32
    )

    def error(image: NDArray[np.uint8]) -> float:
        return float(np.std(cv2.GaussianBlur(image - levels, (0, 0), 1.6)[8:-8, 8:-8]))

    assert np.abs(rounded(levels.copy()).sum(axis=1) - levels.sum(axis=1)).max() <= 0.51
    assert np.abs(rounded(levels.copy()) - levels).max() <= 1.01
    assert error(rounded(levels.copy())) < 0.6 * error(np.rint(levels).astype(np.uint8))
    assert rounded(np.array([[254.9, 256, 255], [-0.4, 0, 0.3]], np.float32)).tolist() == [
        [255, 255, 255],
        [0, 0, 0],
    ]


def test_files_keep_their_names_and_one_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "grey" / "west").mkdir(parents=True)
    names = ["west/1.png", "2.jpg", "3.png"]
    image = texture()
    (tmp_path / "grey" / names[0]).write_bytes(encode_image(image, b"", "png"))
    (tmp_path / "grey" / names[1]).write_bytes(encode_image(image, b"", "jpeg"))
    (tmp_path / "grey" / "3.png").write_bytes(b"no image")
    with quiet():
        written = write_as_doubled(tmp_path / "grey", names, tmp_path / "made", 3200, 2)
        made = pycolmap.Bitmap.read(tmp_path / "made" / "west/1.png", as_rgb=False)
    assert written == names[:2]
    assert made is not None
    assert np.array_equal(np.asarray(made.to_array()).reshape(image.shape), as_doubled(image))
