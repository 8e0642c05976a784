"""What contrast is measured from, compiled, against OpenCV and NumPy in float64."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from oracle import scene

from colmap_ihe.grey import bands, contrast

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
DTYPES: tuple[Any, ...] = (np.uint8, np.uint16)
Pixels = NDArray[np.uint8] | NDArray[np.uint16]


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
        whole, expected = bands.measure_detail(tile, contrast._band(4 * most)), detail(tile, most)
        assert whole[6] == expected[6]
        assert_close(whole[:6], expected[:6], expected[6], 4 * most)
    parts, expected = bands.measure_blocks(tile, contrast._band(most)), blocks(tile, most)
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
        bands.measure_detail(np.zeros((25, 40, 3), np.uint8), contrast._band(255))
    with pytest.raises(ValueError, match="at least 14 pixels"):
        bands.measure_blocks(np.zeros((40, 13, 3), np.uint8), contrast._band(255))
    with pytest.raises(ValueError, match="dtype"):
        bands.measure_blocks(np.zeros((40, 40, 3), np.float32), contrast._band(255))


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
