"""The histogram: counting is exact, adding is pooling, and neither order nor grouping shows."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import pooled, scene

from colmap_ihe.grey.histogram import LINEAR_EDGES, Histogram, Weighting
from colmap_ihe.grey.weights import Encoding


def same(first: Histogram, second: Histogram) -> bool:
    return (
        bool(np.array_equal(first.table(), second.table()))
        and (first.images, first.pixels) == (second.images, second.pixels)
        and first.encoding == second.encoding
    )


def test_coded_colours_are_counted_exactly() -> None:
    image = scene(1, 90, 70)
    colours, counts = np.unique(image.reshape(-1, 3), axis=0, return_counts=True)
    codes, mass = pooled([image]).colours()
    np.testing.assert_array_equal(codes, colours)
    np.testing.assert_array_equal(mass, counts)


def test_linear_values_lie_in_the_cell_that_counts_them() -> None:
    rng = np.random.default_rng(2)
    image = (65535 * rng.random((60, 80, 3)) ** 3).astype(np.uint16)
    image[0, :3] = [[0, 0, 0], [65535, 65535, 65535], [0, 65535, 1]]
    codes, mass = pooled([image], "linear").colours()
    assert mass.sum() == 60 * 80
    flat = image.reshape(-1, 3)
    for code, pixels in list(zip(codes, mass, strict=True))[::97]:
        assert ((flat >= LINEAR_EDGES[code]) & (flat < LINEAR_EDGES[code + 1])).all(axis=1).sum() == pixels


def test_linear_cells_cover_all_values_once_and_widen_with_the_square_root() -> None:
    assert LINEAR_EDGES[0] == 0
    assert LINEAR_EDGES[-1] == 65536
    widths = np.diff(LINEAR_EDGES)
    assert widths.min() >= 1
    middles = (LINEAR_EDGES[1:] + LINEAR_EDGES[:-1]) / 2
    # d(sqrt v) = dv / (2 sqrt v): a width of 2 sqrt(65535) / 256 times sqrt(v), to one value of rounding.
    np.testing.assert_allclose(widths[1:], 2 * np.sqrt(middles[1:]), atol=1.5)


@pytest.mark.parametrize("encoding", ["coded", "linear"])
@settings(max_examples=12)  # each histogram is 128 MB
@given(order=st.permutations(range(5)), cut=st.integers(0, 5), weighting=st.sampled_from(["pixel", "image"]))
def test_order_and_grouping_change_nothing(
    encoding: Encoding, order: list[int], cut: int, weighting: Weighting
) -> None:
    images: list[NDArray[Any]] = [scene(n, 8 + 2 * n, 16 + n) for n in range(5)]
    if encoding == "linear":
        images = [image.astype(np.uint16) * 257 for image in images]
    whole = pooled(images, encoding, weighting)
    shuffled = [images[n] for n in order]
    parts = pooled(shuffled[:cut], encoding, weighting) + pooled(shuffled[cut:], encoding, weighting)
    assert same(whole, parts)
    assert whole.images == 5
    assert whole.pixels == sum(i.shape[0] * i.shape[1] for i in images)


def test_adding_leaves_both_parts_as_they_were() -> None:
    first, second = pooled([scene(1, 20, 20)]), pooled([scene(2, 20, 20)])
    before = first.table()
    total = first + second
    total.add(scene(3, 20, 20))
    np.testing.assert_array_equal(first.table(), before)
    assert (first.images, second.images, total.images) == (1, 1, 3)


def test_every_image_has_the_same_mass_under_weighting_image() -> None:
    small, large = np.zeros((10, 12, 3), np.uint8), np.full((300, 400, 3), 200, np.uint8)
    _, masses = np.unique(pooled([small, large], weighting="image").table(), return_counts=True)
    assert masses.tolist() == [256**3 - 2, 1, 1]
    _, mass = pooled([small, large], weighting="image").colours()
    assert abs(mass[0] / mass[1] - 1) < 1e-4
    _, plain = pooled([small, large]).colours()
    assert plain.tolist() == [120, 120_000]


@pytest.mark.parametrize(
    ("encoding", "image"),
    [
        *(("coded", np.zeros(shape, np.uint8)) for shape in ((4, 4), (4, 4, 4), (0, 4, 3))),
        *(("coded", np.zeros((4, 4, 3), dtype)) for dtype in (np.uint16, np.float32)),
        ("linear", np.zeros((4, 4, 3), np.uint8)),
    ],
)
def test_another_shape_or_dtype_is_refused_with_what_came(encoding: Encoding, image: NDArray[Any]) -> None:
    histogram = Histogram(encoding)
    with pytest.raises(ValueError, match=r"rgb\.shape=.*expected \(H, W, 3\)"):
        histogram.add(image)
    assert histogram.pixels == histogram.images == histogram.table().sum() == 0


def test_coded_and_linear_do_not_add() -> None:
    with pytest.raises(ValueError, match="do not add"):
        Histogram("coded") + Histogram("linear")


def test_more_pixels_than_a_cell_of_32_bits_holds() -> None:
    one = pooled([np.full((40, 50, 3), 7, np.uint8), scene(1, 40, 50)])
    many = one
    for _ in range(22):
        many = many + many
    assert int(many.table().max()) > 2**32
    np.testing.assert_array_equal(many.table(), one.table() << np.uint64(22))
    assert same(pickle.loads(pickle.dumps(many)), many)
