"""Level colours across seams.

What photographs of different exposure, or of different angles to the light, show of one place is made alike where they
meet, and changes smoothly away from there. Waechter, Moehrle and Goesele 2014 ("Let There Be Color!"), section 4.2,
after Lempitsky and Ivanov 2007: one offset for each corner of the cut mesh, so that the sums of colour and offset agree
on both sides of each seam and offsets of neighbours differ little. Over many seams such offsets add up to colours that
no photograph shows, so each is drawn a little to what the photographs of the place agree on. Solved by conjugate
gradients with a diagonal preconditioner.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from colmap_ihe.dense.camera import Bool, Float64, Int64
from colmap_ihe.dense.texture.atlas import Patches

_SMOOTH = 0.1  # weight of the difference between neighbours in a patch; of Waechter's lambda, the inverse
_REST = 1e-4  # weight of an offset itself, which holds the mean
_DRAWN = 1e-3  # the same, of its distance from where photographs agree: over some ten vertices, so that seams stay shut
_HELD = 1e4  # the same, of a corner that is to stay
_TOLERANCE, _ROUNDS = 3e-4, 600


def seam_offsets(patches: Patches, colours: Float64, seen: Bool, agreed: Float64) -> Float64:
    """Return (P, 3) float64: what to add to the colours of each corner of the cut mesh.

    `colours` (P, 3) are those of its photograph there; `seen` (P,) is False where no photograph shows it: such a corner
    follows its neighbours, and does not draw them. `agreed` (P, 3) are the colours by all photographs there, from which
    the levelled ones are not to drift away; NaN where that is not known.
    """
    if colours.shape != (len(patches.vertex), 3):
        raise ValueError(f"{colours.shape=}, expected ({len(patches.vertex)}, 3)")
    seams, edges = _seams(patches), _edges(patches)
    ends = np.concatenate((seams, edges)).astype(np.int64)
    is_seam = np.arange(len(ends)) < len(seams)
    # The offset of the first end less that of the second: on seams as large as the difference of colours, else zero.
    difference = np.zeros((len(ends), 3))
    difference[: len(seams)] = colours[seams[:, 1]] - colours[seams[:, 0]]
    both = np.asarray(seen[ends].all(axis=1))
    known = seen & np.isfinite(agreed).all(axis=1)
    goal = np.where(known[:, None], agreed - colours, 0.0)
    rest = np.where(known, _DRAWN, _REST)[:, None]
    to_go = difference - (goal[ends[:, 0]] - goal[ends[:, 1]])
    offsets = goal + _levelled(patches, ends, to_go, is_seam, both, rest)
    left = difference - (offsets[ends[:, 0]] - offsets[ends[:, 1]])
    held = np.where(seen, _HELD, _REST)[:, None]
    followed = _levelled(patches, ends, left, is_seam, ~both, held)
    return np.where(seen[:, None], offsets, offsets + followed)


def _levelled(
    patches: Patches, ends: Int64, difference: Float64, is_seam: Bool, taken: Bool, rest: Float64
) -> Float64:
    """Return (P, 3), the offsets by those of `ends` that are `taken`, from a start with which few rounds lead on: the
    offsets where all corners of a patch have the same. Zero at corners that are no such ends."""
    patch = np.zeros(len(patches.vertex), np.int64)
    patch[patches.faces] = patches.patch[:, None]
    weight = np.where(is_seam, 1.0, _SMOOTH)[:, None]
    of_patch = np.asarray(np.bincount(patch, rest[:, 0])[:, None], np.float64)
    seams, none = taken & is_seam, np.zeros((len(of_patch), 3))
    start = _solve(patch[ends[seams]], weight[seams], difference[seams], of_patch, none)[patch]
    used = np.zeros(len(patch), bool)
    used[ends[taken]] = True
    row = np.cumsum(used) - 1
    offsets = np.zeros((len(patch), 3))
    offsets[used] = _solve(row[ends[taken]], weight[taken], difference[taken], rest[used], start[used])
    return offsets


def _solve(ends: Int64, weight: Float64, difference: Float64, rest: Float64, start: Float64) -> Float64:
    """Return (N, 3), offsets of least squares: `difference` (E, 3) is expected between those of `ends` (E, 2), by
    `weight` (E, 1), and zero of each by `rest` (N, 1)."""
    count = len(start)
    diagonal = rest[:, 0] + np.bincount(ends.ravel(), np.repeat(weight, 2), count)
    first, second = np.ascontiguousarray(ends.T)  # read once a round
    weights, rests = np.ascontiguousarray(weight[:, 0]), np.ascontiguousarray(rest[:, 0])

    def times(offsets: Float64) -> Float64:
        product = rests * offsets
        for k, channel in enumerate(offsets):
            pull = weights * (channel.take(first) - channel.take(second))
            product[k] += np.bincount(first, pull, count)
            product[k] -= np.bincount(second, pull, count)
        return product

    target = _scatter(ends, weight * difference, count)
    return _conjugate_gradients(times, target, diagonal, np.ascontiguousarray(start.T)).T


def _seams(patches: Patches) -> Int64:
    """Return (S, 2), pairs of corners of one vertex, in different patches."""
    order = np.argsort(patches.vertex, kind="stable")
    same = patches.vertex[order][1:] == patches.vertex[order][:-1]
    return np.stack((order[:-1][same], order[1:][same]), axis=1)


def _edges(patches: Patches) -> Int64:
    """Return (E, 2), pairs of corners that an edge within a patch joins."""
    edges = np.sort(patches.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = np.sort(edges[:, 0] * len(patches.vertex) + edges[:, 1])
    keys = keys[np.flatnonzero(np.diff(keys, prepend=-1))]
    return np.stack(np.divmod(keys, len(patches.vertex)), axis=1)


def _scatter(ends: Int64, values: Float64, count: int) -> Float64:
    """Return (3, count): the sum of `values` (N, 3) at first ends less that at second ends."""
    first, second = ends.T
    return np.stack([np.bincount(first, v, count) - np.bincount(second, v, count) for v in values.T])


def _conjugate_gradients(
    times: Callable[[Float64], Float64], target: Float64, diagonal: Float64, start: Float64
) -> Float64:
    """Solve for all channels (3, N) at once (Hestenes and Stiefel 1952)."""
    solution = start.copy()
    rest = target - times(start)
    scaled = rest / diagonal
    direction = scaled.copy()
    energy = _products(rest, scaled)
    goal = _TOLERANCE**2 * np.maximum((target**2 / diagonal).sum(axis=1), 1e-30)
    for _ in range(_ROUNDS):
        if (energy <= goal).all():
            break
        image = times(direction)
        step = (energy / np.maximum(_products(direction, image), 1e-300))[:, None]
        solution += step * direction
        rest -= step * image
        scaled = rest / diagonal
        before, energy = energy, _products(rest, scaled)
        direction = scaled + (energy / np.maximum(before, 1e-300))[:, None] * direction
    return solution


def _products(a: Float64, b: Float64) -> Float64:
    """Return (3,), the scalar products of the channels of two (3, N)."""
    return np.asarray(np.einsum("kn,kn->k", a, b))
