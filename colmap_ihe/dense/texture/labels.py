"""Label the faces of a mesh so that few patches come about at little cost.

The energy is that of a Potts model: the costs of the labels, and a price for each edge between faces of different
labels. Single faces change their labels first (iterated conditional modes, Besag 1986), which stops in the nearest
minimum. Then whole patches take the label of a neighbour wherever that lowers the energy, and become one with it: a
patch crosses the barrier that its faces one by one do not. At the end patches of a few faces are given away at any
cost. Faces that no photograph colours lose little where they are folded or hidden on a picture, and would be patches of
one to ten faces each; so they may go to any.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, Int32, Int64
from colmap_ihe.dense.texture.mesh import components

_FIRST_EDGE, _EDGE = 0.4, 1.0  # price of an edge between labels, while faces settle and from then on
_FACE_ROUNDS = 12
_PATCH_ROUNDS = 60
_SMALL = 22  # faces: patches below go to a neighbour that can take them, whatever that costs
_STRANGE = 1.0  # cost of a picture that does not show a face, for one that has no colours of photographs
_LEAST_GAIN = 1e-6
_NO_LABEL = -2  # beside a face that has fewer neighbours than others


@dataclass(frozen=True)
class Choices:
    """Hold `label` (F, K) int32, the labels that each face may have, and `cost` (F, K) float32, infinite where an
    entry is none; `count` is above all labels. A patch may also have another label below `pictures`, at a price for
    each face, where that is no choice of those of its faces only that are `free` (F,)."""

    label: Int32
    cost: Float32
    count: int
    free: Bool
    pictures: int


def label_faces(choices: Choices, pairs: Int64) -> Int32:
    """Return (F,) int32, the label of each face; `pairs` (E, 2) are neighbouring faces. Each needs a finite cost."""
    rows = np.arange(len(choices.label))
    labels = choices.label[rows, np.argmin(choices.cost, axis=1)]
    beside = _beside(len(labels), pairs)
    labels = _change_faces(choices, labels, beside, _FIRST_EDGE)
    labels = _change_patches(choices, labels, pairs, small=0)
    labels = _change_faces(choices, labels, beside, _EDGE)
    return _change_patches(choices, labels, pairs, small=_SMALL)


def _change_faces(choices: Choices, labels: Int32, beside: Int64, edge: float) -> Int32:
    """Give each face the label of least energy, half of those that would change at a time: all at once would swap for
    ever. Only faces beside another label can gain; `beside` (F, N) are the neighbours, as `_beside` gives them."""
    draw = np.random.default_rng(0)
    for _ in range(_FACE_ROUNDS):
        around = np.append(labels, _NO_LABEL)[beside]
        faces = np.flatnonzero(((around != labels[:, None]) & (around != _NO_LABEL)).any(axis=1))
        choice, cost = choices.label[faces], choices.cost[faces]
        agreeing = sum(choice == around[faces, k, None] for k in range(beside.shape[1]))
        energy = cost - edge * agreeing
        best = choice[np.arange(len(faces)), np.argmin(energy, axis=1)]
        now = np.where(choice == labels[faces, None], energy, np.inf).min(axis=1)
        gains = energy.min(axis=1) < now - _LEAST_GAIN
        if not gains.any():
            break
        gains &= draw.random(len(faces)) < 0.5
        labels = labels.copy()
        labels[faces[gains]] = best[gains]
    return labels


def _beside(count: int, pairs: Int64) -> Int64:
    """Return (F, N), the neighbours of each of `count` faces, and `count` where it has fewer than others."""
    face, neighbour = np.concatenate((pairs, pairs[:, ::-1])).T
    order = np.argsort(face, kind="stable")
    face, neighbour = face[order], neighbour[order]
    number = np.bincount(face, minlength=count)
    place = np.arange(len(face)) - (np.cumsum(number) - number)[face]
    table = np.full((count, int(number.max(initial=0))), count)
    table[face, place] = neighbour
    return table


def _change_patches(choices: Choices, labels: Int32, pairs: Int64, small: int) -> Int32:
    """Give whole patches the label of a neighbour where all of their faces may have it and the energy falls, or where
    the patch has less than `small` faces; among neighbours the one that gains most goes first."""
    patch = components(len(labels), pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]])
    size = np.bincount(patch)
    label = np.zeros(len(size), np.int64)
    label[patch] = labels
    cost = _patch_costs(choices, patch, size)
    ends = patch[pairs]
    node = patch
    for _ in range(_PATCH_ROUNDS):
        ends = ends[ends[:, 0] != ends[:, 1]]
        best, gain = _best_neighbour(cost, label, ends)
        gain += np.where(size < small, 1e9 - 1e6 * size, 0)  # the smallest first
        goes = (gain > _LEAST_GAIN) & _gains_most(gain, ends)
        if not goes.any():
            break
        label = np.where(goes, best, label)
        merged = components(len(label), ends[label[ends[:, 0]] == label[ends[:, 1]]])
        kept = np.zeros(int(merged.max()) + 1, np.int64)
        kept[merged] = label
        total = np.zeros((len(kept), choices.count))
        np.add.at(total, merged, cost)
        cost, label, size = total, kept, np.bincount(merged, size).astype(np.int64)
        node, ends = merged[node], merged[ends]
    return label[node].astype(np.int32)


def _patch_costs(choices: Choices, patch: Int64, size: Int64) -> Float64:
    """Return (P, L), the sum of the costs of each label over the faces of a patch, infinite where one cannot have
    it."""
    shape = len(size), choices.count
    listed = np.isfinite(choices.cost)
    shown = listed & choices.free[:, None] & (choices.label < choices.pictures)
    key = patch[:, None] * choices.count + choices.label
    cost = np.bincount(key[listed], choices.cost[listed], shape[0] * shape[1]).reshape(shape)
    able = np.bincount(key[listed], minlength=cost.size).reshape(shape)
    strange = np.bincount(patch, choices.free)[:, None] - np.bincount(
        key[shown], minlength=cost.size
    ).reshape(shape)
    strange[:, choices.pictures :] = 0
    return np.where(able + strange == size[:, None], cost + _STRANGE * strange, np.inf)


def _best_neighbour(cost: Float64, label: Int64, ends: Int64) -> tuple[Int64, Float64]:
    """Return (P,), the best label among those of each patch's neighbours, and by how much the energy would fall,
    minus infinity where there is none. `ends` (E, 2) are patches on both sides of the edges of faces."""
    first, second = ends.T
    key = np.concatenate((first * cost.shape[1] + label[second], second * cost.shape[1] + label[first]))
    shared = np.bincount(key, minlength=cost.size).reshape(cost.shape)
    rows = np.arange(len(label))
    others = np.where(shared > 0, cost - _EDGE * shared, np.inf)
    best = np.argmin(others, axis=1)
    return best, cost[rows, label] - others[rows, best]


def _gains_most(gain: Float64, ends: Int64) -> Bool:
    """Return (P,), true where no neighbour gains more, or as much and has a smaller number."""
    order = np.lexsort((np.arange(len(gain)), -gain))
    rank = np.empty(len(gain), np.int64)
    rank[order] = np.arange(len(gain))
    best = rank.copy()
    for first, second in (ends.T, ends[:, ::-1].T):
        np.minimum.at(best, first, rank[second])
    return np.asarray(best == rank)
