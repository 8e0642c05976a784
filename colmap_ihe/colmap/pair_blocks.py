"""Divide pairs of images into blocks that are matched together, each with many pairs of few images.

COLMAP's matcher builds an index of each image that it meets, which takes as long as two pairs do, and each
image has to be brought to where its block is matched. Of a large set blocks are of two groups of images; the
pairs of a small one are shared out among the workers, a block for each.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Collection, Sequence

from colmap_ihe.colmap.part_databases import Pair, ordered

_PAIR_SECONDS = 1.2e-5  # a feature of one of its images
_BLOCK_SECONDS = 80.0  # what is lost with a worker
_BATCH_SECONDS, _LEAST_BATCH = 5.0, 50  # of fewer pairs COLMAP builds indexes again and again
_INDEX_PAIRS = 2  # that take as long as the index of an image
_FEW_IMAGES = 50  # of more, the search for the best blocks would itself take long
_GROUPS_A_BLOCK = 3  # the images of a block at the most
_PROCESS_BYTES = 110_000_000
_BYTES_A_FEATURE = 420  # of the images of a block; measured with benchmarks/limits.py


def matches_bytes(features: int, images: int) -> int:
    """Return the bytes of memory of a process that matches blocks of `images` images with so many features each."""
    together = min(images, _GROUPS_A_BLOCK * _most_of_a_group(features))
    return _PROCESS_BYTES + _BYTES_A_FEATURE * features * together


def _most_of_a_group(features: int) -> int:
    """Return the number of images of a group, so that the pairs of two groups are not more than may be lost."""
    return max(2, math.isqrt(round(_BLOCK_SECONDS / (_PAIR_SECONDS * max(1, features)))))


def seconds_of(pairs: Collection[Pair], features: int) -> float:
    """Return about how long one core matches pairs of images with so many features, with their indexes."""
    images = {image_id for pair in pairs for image_id in pair}
    return _PAIR_SECONDS * features * (len(pairs) + _INDEX_PAIRS * len(images))


def are_few(images: int, features: int) -> bool:
    """Tell whether a set is small: with a worker no more would be lost than with one of a large set."""
    return images <= min(_FEW_IMAGES, _most_of_a_group(features))


def batch_of(features: int) -> int:
    """Return the number of pairs after which COLMAP looks whether it is to stop."""
    return max(_LEAST_BATCH, round(_BATCH_SECONDS / (_PAIR_SECONDS * max(1, features))))


def group_size(pairs: int, images: int, features: int, width: int) -> int:
    """Return the number of images of a group, for about three blocks for every two of `width` workers, or more."""
    density = pairs / max(1, math.comb(images, 2))
    groups = max(1, -(-images // _most_of_a_group(features)))
    while width > 1 and groups < images and groups + density * math.comb(groups, 2) < 1.5 * width:
        groups += 1
    return max(2, -(-images // groups))


def groups_of(pairs: Sequence[Pair], ids: Sequence[int], size: int) -> list[list[int]]:
    """Return all images in groups of `size`, the last perhaps of fewer: each begins with the first that is left, and
    takes the one that has most pairs with it, as long as there is one."""
    near: dict[int, list[int]] = defaultdict(list)
    for first, second in pairs:
        near[first].append(second)
        near[second].append(first)
    order = {image_id: number for number, image_id in enumerate(ids)}
    left = dict.fromkeys(ids)
    groups: list[list[int]] = []
    while left:
        group: list[int] = []
        shared: Counter[int] = Counter()  # pairs with the group, of images that are left
        while left and len(group) < size:
            image_id = min(shared, key=lambda i: (-shared[i], order[i]), default=next(iter(left)))
            group.append(image_id)
            del left[image_id], shared[image_id]
            shared.update(other for other in near[image_id] if other in left)
        groups.append(group)
    return groups


def blocks_of(pairs: Sequence[Pair], groups: Sequence[Sequence[int]]) -> list[list[Pair]]:
    """Return the pairs of two groups each, or of a group with several others where they are few. The longest first, so
    that all workers end at about the same time."""
    group = {image_id: number for number, images in enumerate(groups) for image_id in images}
    by_groups: dict[tuple[int, int], list[Pair]] = defaultdict(list)
    for first, second in pairs:
        by_groups[ordered((group[first], group[second]))].append((first, second))
    size = max(map(len, groups), default=0)
    blocks: list[list[Pair]] = []
    before, block_images = -1, set[int]()
    for (group_number, _), added in sorted(by_groups.items()):
        images = {image_id for pair in added for image_id in pair}
        both = block_images | images
        small = len(both) <= _GROUPS_A_BLOCK * size
        if small and group_number == before and len(blocks[-1]) + len(added) <= size**2:
            blocks[-1] += added
            block_images = both
        else:
            blocks.append(list(added))
            block_images = images
        before = group_number
    return sorted(blocks, key=len, reverse=True)


def shared_out(pairs: Sequence[Pair], workers: int) -> list[list[Pair]]:
    """Return the pairs of a small set in a block for each of `workers` or fewer, so that the block that takes longest,
    with its indexes, takes as little time as was found; the longest first."""
    images = {image_id for pair in pairs for image_id in pair}
    limits = range(2 * _INDEX_PAIRS + 1, max(2, len(images)) * _INDEX_PAIRS + max(1, len(pairs)) + 1)
    least = bisect_left(limits, True, key=lambda limit: len(_filled(pairs, limit)) <= workers)
    return sorted(_filled(pairs, limits[least]), key=len, reverse=True)


def _filled(pairs: Sequence[Pair], limit: int) -> list[list[Pair]]:
    """Return the pairs in blocks of which each takes at most as long as `limit` pairs without an index."""
    left = list(pairs)
    blocks: list[list[Pair]] = []
    while left:
        taken = _first_block(left, limit)
        blocks.append([pair for pair in left if pair in taken])
        left = [pair for pair in left if pair not in taken]
    return blocks


def _first_block(pairs: Sequence[Pair], limit: int) -> set[Pair]:
    """Return some of the pairs, that take at most as long as `limit`: of one image after another with those before it,
    the one with most such pairs next, of several the one with the fewest pairs in all."""
    near: dict[int, dict[int, Pair]] = defaultdict(dict)
    for first, second in pairs:
        near[first][second] = near[second][first] = (first, second)
    shared = dict.fromkeys(
        sorted(near, key=lambda i: len(near[i])), 0
    )  # pairs with the block, of images that are left
    block: set[Pair] = set()
    room = limit
    while shared and room > _INDEX_PAIRS:
        image_id = max(shared, key=lambda i: shared[i])
        del shared[image_id]
        room -= _INDEX_PAIRS
        added = [pair for other, pair in near[image_id].items() if other not in shared][:room]
        block.update(added)
        room -= len(added)
        shared.update({other: shared[other] + 1 for other in near[image_id] if other in shared})
    return block
