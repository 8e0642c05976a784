"""Which pairs are matched together: all of them, once, in blocks of few images."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.colmap.pair_blocks import are_few, batch_of, blocks_of, group_size, groups_of, shared_out


@pytest.mark.parametrize(("images", "size"), [(8, 2), (50, 16), (3, 16)])
def test_every_pair_is_in_one_block(images: int, size: int) -> None:
    ids = list(range(1, images + 1))
    pairs = [(i, j) for i in ids for j in ids if i < j]
    for some in (pairs, [(i, i + 1) for i in ids[:-1]], pairs[::7], []):
        groups = groups_of(some, ids, size)
        assert sorted(i for group in groups for i in group) == ids
        assert {len(group) for group in groups[:-1]} <= {size}
        blocks = blocks_of(some, groups)
        assert [*map(len, blocks)] == sorted(map(len, blocks), reverse=True)
        assert sorted(pair for block in blocks for pair in block) == some
        assert max(map(len, blocks), default=0) <= size**2
        assert max((len(_images_of(block)) for block in blocks), default=0) <= 3 * size


def _images_of(pairs: list[tuple[int, int]]) -> set[int]:
    return {i for pair in pairs for i in pair}


def test_groups_are_of_images_that_have_pairs_whatever_their_names() -> None:
    """Places on a grid in a random order, each with its 24 nearest: a block loads few images for its pairs."""
    across = 30
    order = np.random.default_rng(1).permutation(across * across)
    at = {int(i): divmod(n, across) for n, i in enumerate(order)}
    steps = [(y, x) for y in range(-2, 3) for x in range(-2, 3) if (y, x) > (0, 0)]
    named = {place: i for i, place in at.items()}
    pairs = [
        (i, named[y + v, x + u]) for i, (y, x) in at.items() for v, u in steps if (y + v, x + u) in named
    ]
    ids = sorted(at)

    def loaded(groups: list[list[int]]) -> float:
        return sum(len(_images_of(block)) for block in blocks_of(pairs, groups)) / len(pairs)

    by_name = [ids[n : n + 24] for n in range(0, len(ids), 24)]
    assert loaded(by_name) > 1.0
    assert loaded(groups_of(pairs, ids, 24)) < 0.3


@pytest.mark.parametrize(
    ("images", "neighbours", "features", "width", "blocks", "most"),
    [
        (11, 10, 12_000, 1, 1, 55),
        (11, 10, 12_000, 2, 3, 30),
        (11, 10, 12_000, 8, 9, 9),
        (200, 199, 8_192, 2, 36, 625),
        (2, 1, 8_192, 16, 1, 1),
        (3000, 10, 800, 2, 33, 910),
        (3000, 10, 800, 64, 77, 390),
    ],
)
def test_blocks_are_enough_for_all_workers_and_none_is_large(
    images: int, neighbours: int, features: int, width: int, blocks: int, most: int
) -> None:
    ids = list(range(images))
    pairs = [(i, j) for i in ids for j in range(i + 1, min(images, i + 1 + neighbours))]
    found = blocks_of(pairs, groups_of(pairs, ids, group_size(len(pairs), images, features, width)))
    assert (len(found), max(map(len, found))) == (blocks, most)


@pytest.mark.parametrize(
    ("images", "neighbours", "workers", "found"),
    [
        (8, 7, 1, [(28, 8)]),
        (8, 7, 2, [(15, 6), (13, 8)]),  # 29 with the indexes, where groups of four give 32
        (11, 10, 2, [(30, 9), (25, 11)]),  # 48, not 52
        (8, 7, 4, [(8, 5), (8, 5), (6, 5), (6, 6)]),  # 18, not 21
        (24, 23, 4, [(76, 13), (76, 13), (66, 18), (58, 22)]),  # 102, not 132
        (11, 3, 2, [(14, 7), (13, 7)]),  # 28, not 35
        (3, 2, 8, [(1, 2)] * 3),
        (0, 0, 2, []),
    ],
)
def test_few_pairs_are_shared_out_so_that_the_longest_block_is_short(
    images: int, neighbours: int, workers: int, found: list[tuple[int, int]]
) -> None:
    pairs = [(i, j) for i in range(images) for j in range(i + 1, min(images, i + 1 + neighbours))]
    blocks = shared_out(pairs, workers)
    assert [(len(block), len(_images_of(block))) for block in blocks] == found
    assert sorted(pair for block in blocks for pair in block) == pairs


def test_pairs_keep_their_way_round_and_pieces_without_a_pair_between_them_share_a_worker() -> None:
    pairs = [(5, 9), (9, 1), (1, 5), (2, 3), (7, 6), (6, 8), (8, 7), (4, 4)]
    first, second = shared_out(pairs, 2)
    assert sorted(first + second) == sorted(pairs)
    assert (len(first), len(second)) == (4, 4)


def test_few_are_those_of_which_a_worker_loses_little() -> None:
    assert [are_few(n, 8_192) for n in (28, 29)] == [True, False]
    assert [are_few(n, 800) for n in (50, 51)] == [True, False]


def test_colmap_looks_up_every_few_seconds_but_keeps_its_indexes() -> None:
    assert [batch_of(features) for features in (0, 800, 8_192, 30_000)] == [416_667, 521, 51, 50]
