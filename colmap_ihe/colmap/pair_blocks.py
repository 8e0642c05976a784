"""Which pairs are matched together: blocks, each with many pairs of few images.

COLMAP's matcher builds an index of each image that it meets, which takes as long as two pairs do, and each image has to
be brought to where its block is matched.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from heapq import heappop, heappush

Pair = tuple[int, int]
"""The ids of two images."""

_PAIR_SECONDS = 1.2e-5  # a feature of one of its images
_BLOCK_SECONDS = 80.0  # what is lost with a worker
_BATCH_SECONDS, _LEAST_BATCH = 5.0, 50  # of fewer pairs COLMAP builds indexes again and again
_GROUPS_A_BLOCK = 3  # the images of a block at the most
_PROCESS_BYTES = 110_000_000
_BYTES_A_FEATURE = 420  # of the images of a block; measured with benchmarks/limits.py


def matches_bytes(features: int, images: int) -> int:
    """What a process takes of memory that matches images of so many features each, of `images` in all."""
    return _PROCESS_BYTES + _BYTES_A_FEATURE * features * min(
        images, _GROUPS_A_BLOCK * _most_of_a_group(features)
    )


def _most_of_a_group(features: int) -> int:
    """Images, so that the pairs of two groups are not more than what may be lost."""
    return max(2, math.isqrt(round(_BLOCK_SECONDS / (_PAIR_SECONDS * max(1, features)))))


def batch_of(features: int) -> int:
    """Pairs of images with so many features after which COLMAP looks whether it is to stop."""
    return max(_LEAST_BATCH, round(_BATCH_SECONDS / (_PAIR_SECONDS * max(1, features))))


def group_size(pairs: int, images: int, features: int, width: int) -> int:
    """Images of a group, for about three blocks for every two of `width` workers, or more."""
    density = pairs / max(1, math.comb(images, 2))
    groups = max(1, -(-images // _most_of_a_group(features)))
    while width > 1 and groups < images and groups + density * math.comb(groups, 2) < 1.5 * width:
        groups += 1
    return max(2, -(-images // groups))


def groups_of(pairs: Sequence[Pair], ids: Sequence[int], size: int) -> list[list[int]]:
    """All images in groups of `size`, the last perhaps of fewer: each begins with the first that is left, and takes
    the one that has most pairs with it, for as long as there is one."""
    near: dict[int, list[int]] = defaultdict(list)
    for one, other in pairs:
        near[one].append(other)
        near[other].append(one)
    place = {image_id: number for number, image_id in enumerate(ids)}
    left = dict.fromkeys(ids)
    groups: list[list[int]] = []
    while left:
        group: list[int] = []
        groups.append(group)
        shared: dict[int, int] = defaultdict(int)
        waiting: list[tuple[int, int, int]] = []
        while left and len(group) < size:
            while waiting:
                negative, _, image_id = heappop(waiting)
                if image_id in left and -negative == shared[image_id]:
                    break
            else:
                image_id = next(iter(left))
            group.append(image_id)
            del left[image_id]
            for other in near[image_id]:
                if other in left:
                    shared[other] += 1
                    heappush(waiting, (-shared[other], place[other], other))
    return groups


def blocks_of(pairs: Sequence[Pair], groups: Sequence[Sequence[int]]) -> list[list[Pair]]:
    """The pairs of two groups; those of a group with several others where they are few. The longest first, so that
    all workers end at about the same time."""
    group = {image_id: number for number, some in enumerate(groups) for image_id in some}
    by_groups: dict[tuple[int, int], list[Pair]] = defaultdict(list)
    for one, other in pairs:
        by_groups[min(group[one], group[other]), max(group[one], group[other])].append((one, other))
    size = max(map(len, groups), default=0)
    blocks: list[list[Pair]] = []
    before, images = -1, set[int]()
    for (first, _), some in sorted(by_groups.items()):
        these = {image_id for pair in some for image_id in pair}
        both = images | these
        if first == before and len(blocks[-1]) + len(some) <= size**2 and len(both) <= _GROUPS_A_BLOCK * size:
            blocks[-1] += some
            images = both
        else:
            blocks.append(list(some))
            images = these
        before = first
    return sorted(blocks, key=len, reverse=True)
