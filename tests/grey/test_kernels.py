"""The compiled loops against NumPy and OpenCV, one by one; and what contrast makes of bands."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import pooled, scene

from colmap_ihe.grey import contrast, kernels
from colmap_ihe.grey.boxes import boxes_of, estimates_of, whites_of
from colmap_ihe.grey.histogram import LINEAR_EDGES, Cells
from colmap_ihe.grey.weights import linear_rules, parts_rule, triplets

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
DTYPES: tuple[Any, ...] = (np.uint8, np.uint16)
Pixels = NDArray[np.uint8] | NDArray[np.uint16]


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


def place_of(codes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Where a table counts the codes (..., 3)."""
    red, green, blue = (codes[..., c].astype(np.int64) for c in range(3))
    return np.asarray((red - green & 255) << 16 | (blue - green & 255) << 8 | green)


def test_every_code_has_a_place_of_its_own() -> None:
    rng = np.random.default_rng(4)
    codes = rng.integers(0, 256, (5000, 3), np.uint8)
    np.testing.assert_array_equal(kernels.codes_at(place_of(codes)), codes)
    table = kernels.Table()
    kernels.count_colours(codes, table, np.zeros(65536, np.uint8))
    expected = np.bincount(place_of(codes), minlength=kernels.CELLS)
    np.testing.assert_array_equal(table.at(slice(None)), expected)


@pytest.mark.parametrize("n", [65534, 65535, 65536, 131070, 131071, 400_000])
def test_counts_that_fill_their_low_part_go_on(n: int) -> None:
    codes = np.full((n + 7, 3), (200, 3, 77), np.uint8)
    codes[n:] = np.arange(7)[:, None]
    table = kernels.Table()
    kernels.count_colours(codes, table, np.zeros(65536, np.uint8))
    expected = np.bincount(place_of(codes), minlength=kernels.CELLS)
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
    histogram = pooled([scene(3, 120, 90)])
    keys, masses = histogram.occupied()
    assert (np.diff((keys >> np.uint64(24)).astype(np.int64)) > 0).all()
    place = (keys & np.uint64((1 << 24) - 1)).astype(np.int64)
    np.testing.assert_array_equal(np.sort(place), np.flatnonzero(histogram.table()))
    np.testing.assert_array_equal(histogram.table()[place], masses)
    for bits in (1, 3):
        cube = kernels.codes_at(place).astype(int) >> bits
        changes = (np.diff(cube, axis=0) != 0).any(axis=1).sum() + 1
        assert changes == len(np.unique(cube, axis=0))


def linear_cells() -> tuple[NDArray[np.uint16], Cells]:
    image = scene(5, 160, 120).astype(np.uint16) * 257
    return image, pooled([image], "linear").occupied()


@pytest.mark.parametrize("bits", [4, 2, 0])
def test_boxes_hold_every_pixel_and_no_other(bits: int) -> None:
    image, cells = linear_cells()
    boxes = boxes_of(cells, bits)
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
    image, cells = linear_cells()
    grid = triplets(0.1)
    rules = linear_rules(grid, whites_of(boxes_of(cells, 2), grid))
    exact = (kernels.count_pixels(image, rules).astype(float) ** 2).sum(axis=1)
    assert np.abs(estimates_of(boxes_of(cells, bits), rules) / exact - 1).max() < 0.5


def test_what_is_not_contiguous_or_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="dtype"):
        kernels.count_colours(np.zeros((4, 3)), kernels.Table(), np.zeros(65536, np.uint8))
    with pytest.raises(ValueError, match="expected contiguous"):
        kernels.count_colours(np.zeros((4, 3), np.uint16), kernels.Table(), np.zeros(256, np.uint8))
    with pytest.raises(ValueError, match="expected contiguous"):
        kernels.occupied(np.zeros(1 << 20, np.uint16))
    with pytest.raises(ValueError, match="multiples of 1024"):
        linear_rules([(0, 100, 0)], [1000])


def picture(seed: int, height: int, width: int, dtype: Any, kind: str = "scene") -> Pixels:
    rng = np.random.default_rng(seed)
    if kind == "random":
        return np.asarray(rng.integers(0, np.iinfo(dtype).max + 1, (height, width, 3)), dtype)
    rgb = scene(seed, height, width)
    rgb[: height // 5], rgb[:, : width // 6] = 0, 255  # a frame and a burnt sky
    return rgb if dtype == np.uint8 else np.asarray(rgb.astype(np.uint16) * 257 - rgb // 2, np.uint16)


def band(values: NDArray[np.float64]) -> NDArray[np.float64]:
    fine = cv2.GaussianBlur(values, (7, 7), 1.0)
    return np.asarray(fine - cv2.GaussianBlur(fine, (7, 7), (1.6**2 - 1) ** 0.5))[6:-6, 6:-6]


def products(d: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([d[..., i] * d[..., j] for i, j in PAIRS], axis=-1)


def exposed(values: NDArray[np.float64], most: float) -> NDArray[np.bool_]:
    brightest = values.max(axis=2)
    return np.asarray((brightest > 0.001 * most) & (brightest < 0.98 * most))


def detail(tile: Pixels, most: float) -> NDArray[np.float64]:
    """(7,): sums of the products, and how many pixels they are of."""
    height, width = (n // 2 for n in tile.shape[:2])
    half = np.asarray(tile[: 2 * height, : 2 * width], np.float64)
    half = half.reshape(height, 2, width, 2, 3).sum(axis=(1, 3))
    around = cv2.erode(exposed(half, 4 * most).astype(np.uint8), np.ones((7, 7), np.uint8))
    counts = around[6:-6, 6:-6] > 0
    return np.append(products(band(half)[counts]).sum(axis=0), counts.sum())


def blocks(tile: Pixels, most: float) -> NDArray[np.float64]:
    """(n, 8): sums of the products and of the values, and how many pixels count."""
    down, across = ((n - 12) // 8 for n in tile.shape[:2])
    values = np.asarray(tile, np.float64)
    inside = values[6:-6, 6:-6]
    each = np.dstack([products(band(values)), inside.sum(axis=2), exposed(inside, most)])
    return np.asarray(
        each[: 8 * down, : 8 * across].reshape(down, 8, across, 8, 8).sum(axis=(1, 3)).reshape(-1, 8)
    )


def assert_close(found: NDArray[Any], expected: NDArray[np.float64], pixels: float, most: float) -> None:
    """Sums (..., 6) of the products of band values, each within what float32 loses of values up to `most`."""
    lost = 4e-7 * most
    typical = np.sqrt(expected[..., :3].max(axis=-1, initial=0) / max(1, pixels))
    allowed = pixels * lost * (2 * typical + lost)
    assert (np.abs(found - expected).max(axis=-1, initial=0) <= allowed).all()


def check(tile: Pixels) -> None:
    most = int(np.iinfo(tile.dtype).max)
    if min(tile.shape[:2]) >= 26:
        whole, expected = kernels.measure_detail(tile, contrast._band(4 * most)), detail(tile, most)
        assert whole[6] == expected[6]
        assert_close(whole[:6], expected[:6], expected[6], 4 * most)
    parts, expected = kernels.measure_blocks(tile, contrast._band(most)), blocks(tile, most)
    assert parts.shape == expected.shape
    np.testing.assert_array_equal(parts[:, 6:], expected[:, 6:])
    assert_close(parts[:, :6], expected[:, :6], 64, most)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("kind", ["random", "scene"])
@pytest.mark.parametrize(
    ("height", "width"), [(14, 14), (20, 20), (26, 26), (27, 31), (41, 26), (160, 160), (163, 149), (33, 700)]
)
def test_bands_are_those_of_opencv(height: int, width: int, kind: str, dtype: Any) -> None:
    check(picture(height, height, width, dtype, kind))


@pytest.mark.parametrize("dtype", DTYPES)
def test_any_layout_of_the_pixels_is_read(dtype: Any) -> None:
    rgb = picture(3, 140, 170, dtype)
    views: tuple[Any, ...] = (
        rgb[7:130, 5:160],
        rgb[::2],
        rgb[:, ::2],
        rgb[::-1],
        rgb[..., ::-1],
        rgb.transpose(1, 0, 2),
        np.asfortranarray(rgb),
        np.dstack([rgb, rgb])[..., 1:4],
        np.frombuffer(b"\0" + rgb.tobytes(), dtype, rgb.size, offset=1).reshape(rgb.shape),  # not aligned
    )
    for view in views:
        check(view)


def test_too_small_a_tile_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 26 pixels"):
        kernels.measure_detail(np.zeros((25, 40, 3), np.uint8), contrast._band(255))
    with pytest.raises(ValueError, match="at least 14 pixels"):
        kernels.measure_blocks(np.zeros((40, 13, 3), np.uint8), contrast._band(255))
    with pytest.raises(ValueError, match="dtype"):
        kernels.measure_blocks(np.zeros((40, 40, 3), np.float32), contrast._band(255))


def of_the_set(tiles: list[Pixels], encoding: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Detail and noise of a photograph in these tiles, as contrast.py tells it."""
    most = 255 if encoding == "coded" else 65535
    parts = [detail(t[4 : n[0] - 4, 4 : n[1] - 4], most) for t in tiles for n in [even(t)]]
    total = np.sum(parts, axis=0)
    seen = matrix(total[:6] / total[6]) / (4 * most) ** 2
    if encoding == "linear":
        kept = np.concatenate([t[exposed(np.asarray(t, np.float64), most)] for t in tiles])
        return seen, np.diag(kept.mean(axis=0) / most * (1, 0.77, 1))
    found = np.concatenate([blocks(t[10:-10, 10:-10], most) for t in tiles])
    found = found[(found[:, 7] == 64) & (found[:, :3] > 0).all(axis=1)]
    rough = (found[:, :3] / np.median(found[:, :3], axis=0)).sum(axis=1)
    quiet = []
    for group in np.array_split(np.argsort(found[:, 6], kind="stable"), 12):
        flat = group[np.argsort(rough[group])][: max(1, len(group) // 20)]
        quiet.append(matrix(found[flat, :6].mean(axis=0)) / (8 * most) ** 2)
    quiet.sort(key=np.trace)
    return seen, np.mean(quiet[:6], axis=0) + np.eye(3) * (0.03 / 12 / 255**2)


def even(tile: Pixels) -> list[int]:
    return [n // 2 * 2 for n in tile.shape[:2]]


def matrix(six: NDArray[np.float64]) -> NDArray[np.float64]:
    whole = np.zeros((3, 3))
    for (i, j), value in zip(PAIRS, six, strict=True):
        whole[i, j] = whole[j, i] = value
    return whole


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(("height", "width"), [(300, 420), (611, 905), (1000, 1500), (135, 2900)])
def test_contrast_is_that_of_numpy(height: int, width: int, dtype: Any) -> None:
    encoding: Any = "coded" if dtype == np.uint8 else "linear"
    rgb = picture(height, height, width, dtype)
    found = contrast.Contrast(encoding)
    found.add(rgb)
    signal, noise = of_the_set(list(contrast._tiles(rgb)), encoding)
    pixels = height * width
    np.testing.assert_allclose(found.signal / pixels, signal, rtol=0, atol=1e-5 * signal.max())
    np.testing.assert_allclose(found.noise / pixels, noise, rtol=0, atol=1e-5 * noise.max())
