"""COLMAP's options for features, and the memory they take."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from colmap_ihe.colmap.extraction import extraction_bytes, extraction_options
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import OptionError
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.weights import FIXED, Weights
from colmap_ihe.project.options import FeaturesOptions


def test_options_reach_colmap() -> None:
    options = FeaturesOptions(max_image_size=900, colmap={"sift": {"max_num_features": 100}})
    found = extraction_options(options, threads=3)
    assert (found.eff_max_image_size(), found.sift.max_num_features, found.num_threads) == (900, 100, 3)
    assert extraction_options(FeaturesOptions(colmap={"num_threads": 2}), threads=3).num_threads == 2
    with pytest.raises(OptionError, match=r"features\.colmap"):
        extraction_options(FeaturesOptions(colmap={"sift": {"max_features": 100}}))


def test_memory_is_of_the_largest_image_as_colmap_looks_at_it() -> None:
    extraction = extraction_options(FeaturesOptions(max_image_size=1000))
    small = extraction_bytes([(1000, 500)], extraction, 1)
    assert small == 290 * 500_000
    assert extraction_bytes([(1000, 500), (2000, 1000)], extraction, 2) == 2 * small
    extraction.sift.first_octave = 0
    assert extraction_bytes([(1000, 500)], extraction, 1) == small // 4
    extraction.num_threads = 3
    assert extraction_bytes([(1000, 500)], extraction, 1) == round(small / 4 * 3)


def test_colmap_sees_rec709_of_a_colour_image(tmp_path: Path) -> None:
    rgb = np.random.default_rng(3).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    Image.fromarray(rgb).save(tmp_path / "a.png")
    read = pycolmap.Bitmap.read(str(tmp_path / "a.png"), as_rgb=False)
    assert read is not None
    seen = read.to_array()
    expected = to_grey(rgb, Weights(*FIXED["rec709"]))
    assert np.abs(seen.astype(int) - expected).max() <= 1
