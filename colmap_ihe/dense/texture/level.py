"""Colours levelled across seams: what photographs of different exposure, or of different angles to the light, show
of one place is made alike where they meet, and changes smoothly away from there.

Waechter, Moehrle and Goesele 2014 ("Let There Be Color!"), section 4.2, after Lempitsky and Ivanov 2007: one offset
for each corner of the cut mesh, so that the sums of colour and offset agree on both sides of each seam and offsets
of neighbours differ little. Solved by conjugate gradients with a diagonal preconditioner.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.texture.atlas import Patches
from colmap_ihe.dense.texture.mesh import F64, I64, Bool

_SMOOTH = 0.1  # weight of the difference between neighbours in a patch; of Waechter's lambda, the inverse
_REST = 1e-4  # weight of an offset itself, which holds the mean
_TOLERANCE, _ROUNDS = 1e-4, 600


@dataclass(frozen=True)
class _Links:
    """Pairs of rows of the cut mesh: `ends` (N, 2), `weight` (N,), and the `wanted` difference (N, 3) of the offset
    of the first from that of the second."""

    ends: I64
    weight: F64
    wanted: F64


def seam_offsets(patches: Patches, colours: F64, known: Bool) -> F64:
    """(P, 3) float64: what to add to the colours of each corner of the cut mesh.

    `colours` (P, 3) are those that its photograph shows there; `known` (P,) is False where none does.
    """
    if colours.shape != (len(patches.vertex), 3):
        raise ValueError(f"{colours.shape=}, expected ({len(patches.vertex)}, 3)")
    links = _links(patches, colours, known)
    count = len(patches.vertex)
    ends, weight = links.ends, links.weight[:, None]
    diagonal = _REST + np.bincount(ends.ravel(), np.repeat(links.weight, 2), count)
    target = _scatter(ends, weight * links.wanted, count)

    def times(offsets: F64) -> F64:
        return _REST * offsets + _scatter(ends, weight * (offsets[ends[:, 0]] - offsets[ends[:, 1]]), count)

    return _conjugate_gradients(times, target, np.asarray(diagonal[:, None], np.float64))


def _scatter(ends: I64, values: F64, count: int) -> F64:
    """(count, 3): the sum of `values` (N, 3) at first ends less that at second ends."""
    return np.stack(
        [
            np.bincount(ends[:, 0], values[:, k], count) - np.bincount(ends[:, 1], values[:, k], count)
            for k in range(3)
        ],
        axis=1,
    )


def _links(patches: Patches, colours: F64, known: Bool) -> _Links:
    """Seams, between corners of one vertex; and edges within a patch."""
    order = np.argsort(patches.vertex, kind="stable")
    same = patches.vertex[order][1:] == patches.vertex[order][:-1]
    seams = np.stack((order[:-1][same], order[1:][same]), axis=1)
    seams = seams[known[seams].all(axis=1)]
    edges = np.unique(np.sort(patches.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return _Links(
        np.concatenate((seams, edges)).astype(np.int64),
        np.concatenate((np.ones(len(seams)), np.full(len(edges), _SMOOTH))),
        np.concatenate((colours[seams[:, 1]] - colours[seams[:, 0]], np.zeros((len(edges), 3)))),
    )


def _conjugate_gradients(times: Callable[[F64], F64], target: F64, diagonal: F64) -> F64:
    """Solves for all columns at once (Hestenes and Stiefel 1952)."""
    found = np.zeros_like(target)
    rest = target.copy()
    scaled = rest / diagonal
    direction = scaled.copy()
    energy = (rest * scaled).sum(axis=0)
    goal = _TOLERANCE**2 * np.maximum(energy, 1e-30)
    for _ in range(_ROUNDS):
        if (energy <= goal).all():
            break
        image = times(direction)
        step = energy / np.maximum((direction * image).sum(axis=0), 1e-300)
        found += step * direction
        rest -= step * image
        scaled = rest / diagonal
        before, energy = energy, (rest * scaled).sum(axis=0)
        direction = scaled + energy / np.maximum(before, 1e-300) * direction
    return found
