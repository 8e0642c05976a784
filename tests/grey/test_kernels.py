"""The compiled loops against NumPy, one by one."""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import scene

from colmap_ihe.grey import kernels
from colmap_ihe.grey.boxes import Pyramid, estimates_of, whites_of
from colmap_ihe.grey.histogram import LINEAR_EDGES, Histogram
from colmap_ihe.grey.rules import linear_rules, parts_rule
from colmap_ihe.grey.weights import triplets


def test_coded_levels_of_every_value() -> None:
    """Every value of a channel by every weight."""
    rgb = np.zeros((1, 256, 3), np.uint8)
    rgb[0, :, 0] = np.arange(256)
    for red in range(101):
        rule = parts_rule(np.array([red, 100.0 - red, 0]), 100)
        assert rule is not None
        level = kernels.weigh(rgb, rule)[0]
        np.testing.assert_array_equal(level, (red * np.arange(256) + 50) // 100)


@pytest.mark.parametrize("parts", [3, 100, 9_999, 10_000])
def test_other_parts_are_rounded_halves_up(parts: int) -> None:
    rng = np.random.default_rng(parts)
    rgb = rng.integers(0, 256, (300, 400, 3), np.uint8)
    for _ in range(5):
        cuts = np.sort(rng.integers(0, parts + 1, 2))
        whole = np.diff([0, *cuts, parts])
        rule = parts_rule(whole.astype(float), parts)
        assert rule is not None
        expected = (2 * (rgb.astype(np.int64) @ whole) + parts) // (2 * parts)
        np.testing.assert_array_equal(kernels.weigh(rgb, rule), expected)
    assert parts_rule(np.array([0.5, 0.25, 0.25]), 1) is None


@given(st.integers(1, 6400), st.sampled_from(triplets(0.05)))
def test_linear_levels_at_the_edges(step: int, triplet: oracle.Triplet) -> None:
    """Values next to every border between two levels, where a rounded product would slip."""
    white = 1024 * step
    borders = np.arange(1, 256) * white // 256
    value = np.clip((borders[:, None] + np.arange(-101, 102, 25)) // 100, 0, 65535)
    rgb = np.repeat(value.reshape(-1, 1, 1), 3, axis=2).astype(np.uint16)
    rgb[::3, :, 1] //= 2
    counts = kernels.count_pixels(rgb, linear_rules([triplet], [white]))[0]
    expected = np.bincount(oracle.linear_levels(rgb, triplet, white).ravel(), minlength=256)
    np.testing.assert_array_equal(counts, expected)


def test_every_code_has_a_place_of_its_own() -> None:
    rng = np.random.default_rng(4)
    codes = rng.integers(0, 256, (5000, 3), np.uint8)
    np.testing.assert_array_equal(kernels.codes_at(kernels.place_of(codes)), codes)
    table = kernels.Table()
    kernels.count_colours(codes, table, np.zeros(65536, np.uint8))
    expected = np.bincount(kernels.place_of(codes), minlength=kernels.CELLS)
    np.testing.assert_array_equal(table.at(slice(None)), expected)


@pytest.mark.parametrize("n", [65534, 65535, 65536, 131070, 131071, 400_000])
def test_counts_that_fill_their_low_part_go_on(n: int) -> None:
    codes = np.full((n + 7, 3), (200, 3, 77), np.uint8)
    codes[n:] = np.arange(7)[:, None]
    table = kernels.Table()
    kernels.count_colours(codes, table, np.zeros(65536, np.uint8))
    expected = np.bincount(kernels.place_of(codes), minlength=kernels.CELLS)
    np.testing.assert_array_equal(table.at(slice(None)), expected)
    np.testing.assert_array_equal(np.flatnonzero(table.low), np.flatnonzero(expected))


@pytest.mark.parametrize("parts", [1, 2, 3, 7])
@pytest.mark.parametrize("weighed", [False, True])
def test_levels_of_a_table_are_those_of_its_pixels(parts: int, weighed: bool) -> None:
    image = scene(6, 150, 200)
    image[0, :8] = [[r, g, b] for r in (0, 255) for g in (0, 255) for b in (0, 255)]
    table = kernels.Table()
    kernels.count_colours(image, table, np.zeros(65536, np.uint8))
    counts = table.at(slice(None)) if weighed else table
    some = [(21, 72, 7), (100, 0, 0), (0, 0, 100), (0, 100, 0), (1, 98, 1)]
    levels = sum(kernels.count_levels(counts, some, n, parts) for n in range(parts))
    expected = [np.bincount(oracle.coded_levels(image, t).ravel(), minlength=256) for t in some]
    np.testing.assert_array_equal(levels, expected)


def test_occupied_places_run_through_cubes_within_cubes() -> None:
    histogram = Histogram()
    histogram.add(scene(3, 120, 90))
    keys, masses = histogram.occupied()
    assert (np.diff((keys >> np.uint64(24)).astype(np.int64)) > 0).all()
    place = (keys & np.uint64((1 << 24) - 1)).astype(np.int64)
    np.testing.assert_array_equal(np.sort(place), np.flatnonzero(histogram.table()))
    np.testing.assert_array_equal(histogram.table()[place], masses)
    for bits in (1, 3):
        cube = kernels.codes_at(place).astype(int) >> bits
        changes = (np.diff(cube, axis=0) != 0).any(axis=1).sum() + 1
        assert changes == len(np.unique(cube, axis=0))


def linear_pyramid() -> tuple[NDArray[np.uint16], Pyramid]:
    image = scene(5, 160, 120).astype(np.uint16) * 257
    histogram = Histogram("linear")
    histogram.add(image)
    return image, Pyramid(histogram)


@pytest.mark.parametrize("bits", [4, 2, 0])
def test_boxes_hold_every_pixel_and_no_other(bits: int) -> None:
    image, pyramid = linear_pyramid()
    boxes = pyramid.boxes(bits)
    assert int(boxes.mass.sum()) == image.shape[0] * image.shape[1]
    cubes = (np.searchsorted(LINEAR_EDGES, image.reshape(-1, 3), side="right") - 1) >> bits
    cubes, counts = np.unique(cubes, axis=0, return_counts=True)
    assert sorted(counts.tolist()) == sorted(boxes.mass.tolist())
    assert (boxes.low >= 0).all()
    assert (boxes.high >= boxes.low).all()
    edges = LINEAR_EDGES[np.stack((cubes, cubes + 1)) << bits]
    assert boxes.low.min(axis=1).tolist() >= edges[0].min(axis=0).tolist()
    assert boxes.high.max(axis=1).tolist() < edges[1].max(axis=0).tolist()


@pytest.mark.parametrize("bits", [1, 0])
def test_estimates_are_close(bits: int) -> None:
    image, pyramid = linear_pyramid()
    grid = triplets(0.1)
    rules = linear_rules(grid, whites_of(pyramid.boxes(2), grid))
    exact = (kernels.count_pixels(image, rules).astype(float) ** 2).sum(axis=1)
    assert np.abs(estimates_of(pyramid.boxes(bits), rules) / exact - 1).max() < 0.5


def test_what_is_not_contiguous_or_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="dtype"):
        kernels.count_colours(np.zeros((4, 3)), kernels.Table(), np.zeros(65536, np.uint8))
    with pytest.raises(ValueError, match="expected contiguous"):
        kernels.count_colours(np.zeros((4, 3), np.uint16), kernels.Table(), np.zeros(256, np.uint8))
    with pytest.raises(ValueError, match="expected contiguous"):
        kernels.occupied(np.zeros(1 << 20, np.uint16))
    with pytest.raises(ValueError, match="multiples of 1024"):
        linear_rules([(0, 100, 0)], [1000])
