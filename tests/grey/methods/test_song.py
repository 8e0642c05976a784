"""Song's costs against bilateral filters written out pixel by pixel, and its votes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from oracle import scene

from colmap_ihe.grey.methods.song import costs, local_minima, song, song_weights, thumbnail
from colmap_ihe.grey.weights import triplets

GRID = np.array(triplets(0.1)) / 100


def filtered(
    image: NDArray[np.float64], guide: NDArray[np.float64], sigma_space: float, sigma_range: float
) -> NDArray[np.float64]:
    """Joint bilateral filter of image (h, w, 3) by guide (h, w, any), cut at three sigmas."""
    height, width = image.shape[:2]
    out = np.zeros_like(image)
    rows, columns = np.mgrid[:height, :width]
    for y in range(height):
        for x in range(width):
            space = (rows - y) ** 2 + (columns - x) ** 2
            tone = ((guide - guide[y, x]) ** 2).sum(axis=2)
            weight = np.exp(-space / (2 * sigma_space**2) - tone / (2 * sigma_range**2))
            weight[space > (3 * sigma_space) ** 2] = 0
            out[y, x] = (weight[..., None] * image).sum(axis=(0, 1)) / weight.sum()
    return out


def test_costs_are_the_distances_of_the_filters() -> None:
    image = (scene(5, 11, 13) / 255).astype(np.float32)
    found = costs(image)
    exact = image.astype(np.float64)
    for s, sigma_space in enumerate((1, 2, 3)):
        for r, sigma_range in enumerate((0.05, 0.1, 0.2)):
            own = filtered(exact, exact, sigma_space, sigma_range)
            for n in (0, 7, 30, 65):
                joint = filtered(exact, (exact @ GRID[n])[..., None], sigma_space, sigma_range)
                assert found[s, r, n] == pytest.approx(np.abs(own - joint).sum(), rel=1e-3, abs=1e-3)


def test_a_local_minimum_is_below_its_six_neighbours_on_the_triangle() -> None:
    grid = triplets(0.1)
    cost = np.full(66, 5.0)
    cost[grid.index((30, 30, 40))] = 1  # inside
    cost[grid.index((40, 20, 40))] = 2  # a neighbour of it
    cost[grid.index((100, 0, 0))] = 4  # a corner, with two neighbours
    cost[grid.index((50, 10, 40))] = 3  # a neighbour of the second, not of the first
    assert [grid[n] for n in np.flatnonzero(local_minima(cost))] == [(30, 30, 40), (100, 0, 0)]
    assert not local_minima(np.zeros(66)).any()


def test_a_texture_in_one_channel_alone_is_kept_by_that_channel() -> None:
    """Red and green are flat, so only the share of blue matters, and most of it costs least."""
    image = np.full((48, 48, 3), 0.4, np.float32)
    image[..., 2] = (np.indices((48, 48)) // 6).sum(axis=0) % 2 * 0.6
    assert song_weights(image) == (0.0, 0.0, 1.0)
    np.testing.assert_allclose(song(image), image[..., 2], atol=1e-6)


def test_without_colour_the_weights_are_nearest_to_rec709() -> None:
    assert song_weights(np.full((20, 20, 3), 0.3, np.float32)) == (0.2, 0.7, 0.1)


def test_the_thumbnail_has_the_area_of_64_by_64_pixels() -> None:
    assert thumbnail(np.zeros((300, 400, 3), np.float32)).shape == (55, 74, 3)
    assert thumbnail(np.zeros((30, 40, 3), np.float32)).shape == (30, 40, 3)
