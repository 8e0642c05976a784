"""Test the estimate of what dense stereo takes."""

from __future__ import annotations

import pytest

from colmap_ihe.dense.cloud import fusion_share
from colmap_ihe.dense.cost import STEREO_BYTES_A_PIXEL, dense_cost
from colmap_ihe.dense.fusion import FUSION_BYTES

SIZES = [(3000, 2000)] * 20


def test_memory_bounds_how_many_maps_are_made_at_a_time() -> None:
    bytes_a_map = STEREO_BYTES_A_PIXEL * 6_000_000
    assert dense_cost(SIZES, 100_000, "sgm", 8, 0).at_once == 8
    assert dense_cost(SIZES, 100_000, "sgm", 8, 3 * bytes_a_map).at_once == 2
    assert dense_cost(SIZES, 100_000, "sgm", 8, bytes_a_map // 2).at_once == 1
    assert dense_cost(SIZES, 1500, "sgm", 8, 3 * bytes_a_map).at_once == 8


def test_the_estimate_grows_with_pixels_and_not_beyond_the_bound_of_fusion() -> None:
    few, many = (dense_cost(SIZES * n, 3000, "sgm", 2, 0) for n in (1, 10))
    assert many.megapixels == pytest.approx(10 * few.megapixels) == pytest.approx(1200)
    assert few.minutes is not None
    assert many.minutes == pytest.approx(10 * few.minutes)
    assert many.disk_bytes == 10 * few.disk_bytes
    assert many.memory_bytes == max(FUSION_BYTES, 2 * STEREO_BYTES_A_PIXEL * 6_000_000)


def test_portrait_and_landscape_shrink_alike() -> None:
    tall, wide = (dense_cost([size], 1500, "sgm", 1, 0).megapixels for size in ((2000, 3000), (3000, 2000)))
    assert tall == wide == pytest.approx(1.5)


def test_what_was_never_measured_is_not_told() -> None:
    cost = dense_cost(SIZES, 3000, "patchmatch", 8, 0)
    assert (cost.minutes, cost.at_once) == (None, None)
    assert "PatchMatch" in cost.in_words()
    assert "min" not in cost.in_words()


def test_fusion_gets_the_same_memory_though_a_little_more_or_less_is_free() -> None:
    assert [fusion_share(free) for free in (0, 10**12, 2 * FUSION_BYTES)] == [FUSION_BYTES] * 3
    assert fusion_share(2 * FUSION_BYTES - 1) == fusion_share(FUSION_BYTES) == FUSION_BYTES // 2
    assert 0 < fusion_share(1) == fusion_share(1000)
