"""Draw a textured mesh with fewer triangles, on some of its own vertices: arrays in, arrays out.

Vertices are drawn into a neighbour, cheapest first, by the quadric error of Garland and Heckbert (1997). The neighbour
stays where it is and keeps its place on the texture, so the texture stays right. Vertices where patches of the texture
meet, and those at open borders, stay too: no crack opens between patches. Many vertices go in one round, none beside
another; which, is left to chance among the cheaper ones.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

_ROUNDS = 40
_SHARE = 0.6  # of the vertices that may go: the cheaper ones are tried in a round
_LEAST_TURN = 0.3  # cosine, between a triangle before and after
_LEAST_GAIN = 0.005  # of the triangles; a round that takes fewer is the last


def fewer_faces(vertices: npt.NDArray[np.floating], faces: Int64, most: int) -> Int64:
    """Return about `most` triangles (F, 3) on the same `vertices` (V, 3), or more where not enough of them may go."""
    places = np.asarray(vertices, np.float64)
    places = places - places.mean(axis=0) if len(places) else places
    quadrics = _quadrics(places, faces)
    locked = _locked(places, faces)
    chance = np.random.default_rng(0)
    for _ in range(_ROUNDS):
        excess = len(faces) - most
        if excess <= 0:
            break
        target = _one_round(places, faces, quadrics, locked, excess // 2 + 1, chance)
        moved = target != np.arange(len(places))
        np.add.at(quadrics, target[moved], quadrics[moved])
        after = target[faces]
        after = after[(after != np.roll(after, 1, axis=1)).all(axis=1)]
        gain, faces = len(faces) - len(after), after
        if gain < _LEAST_GAIN * len(faces):
            break
    return faces


def _one_round(
    places: Float64, faces: Int64, quadrics: Float64, locked: Bool, most: int, chance: np.random.Generator
) -> Int64:
    """Return (V,), the vertex that each is drawn into: itself, but for at most `most` of them. Locks those that would
    fold a triangle over."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    free = ~locked[start]
    start, end = start[free], end[free]
    cost = _errors(quadrics[start], places[end])
    best = np.full(len(places), np.inf)
    np.minimum.at(best, start, cost)
    is_best = cost == best[start]
    target = np.arange(len(places))
    target[start[is_best]] = end[is_best]
    limit = np.quantile(best[np.isfinite(best)], _SHARE) if len(cost) else 0.0
    chosen = best <= limit
    chosen &= _apart(faces, np.where(chosen, chance.permutation(len(places)), len(places)))
    folded = _folded(places, faces, target, chosen)
    locked |= folded
    chosen &= ~folded
    by_cost = np.flatnonzero(chosen)[np.argsort(best[chosen], kind="stable")]
    chosen[by_cost[most:]] = False
    return np.where(chosen, target, np.arange(len(places)))


def _apart(faces: Int64, rank: Int64) -> Bool:
    """Return (V,): the vertices of lower rank than all of their neighbours."""
    ranks = rank[faces]
    beaten = np.zeros(len(rank), bool)
    beaten[faces[ranks > ranks.min(axis=1, keepdims=True)]] = True
    return np.asarray(~beaten)


def _folded(places: Float64, faces: Int64, target: Int64, chosen: Bool) -> Bool:
    """Return (V,): the chosen vertices of which a triangle would turn over or lose its area."""
    corner = chosen[faces]
    touched = corner.any(axis=1)
    before, corner = faces[touched], corner[touched]
    after = np.where(corner, target[before], before)
    stays = (after != np.roll(after, 1, axis=1)).all(axis=1)
    old, new = _normals(places, before), _normals(places, after)
    lengths = np.linalg.norm(old, axis=1) * np.linalg.norm(new, axis=1)
    bad = stays & ((old * new).sum(axis=1) <= _LEAST_TURN * lengths)
    folded = np.zeros(len(places), bool)
    folded[before[bad][corner[bad]]] = True
    return folded


def _locked(places: Float64, faces: Int64) -> Bool:
    """Return (V,): the vertices that share their place with another, or lie on an edge that is not of two triangles."""
    _, point, times = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    locked = times[point.ravel()] > 1
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = edges[:, 0] * len(places) + edges[:, 1]
    _, which, used = np.unique(key, return_inverse=True, return_counts=True)
    locked[edges[used[which] != 2]] = True
    return np.asarray(locked)


def _normals(places: Float64, faces: Int64) -> Float64:
    corners = places[faces]
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _quadrics(places: Float64, faces: Int64) -> Float64:
    """Return (V, 10): the sum of the squared distances from the planes of a vertex's triangles, by area, as the upper
    half of a symmetric 4 x 4 matrix."""
    normal = _normals(places, faces)
    area = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(area, 1e-30)[:, None]
    plane = np.column_stack([normal, -(normal * places[faces[:, 0]]).sum(axis=1)])
    products = np.stack([plane[:, i] * plane[:, j] * area for i in range(4) for j in range(i, 4)])
    total = np.zeros((len(places), 10))
    for k in range(3):
        for n, values in enumerate(products):
            total[:, n] += np.bincount(faces[:, k], values, len(places))
    return total


def _errors(q: Float64, at: Float64) -> Float64:
    """Return (N,): the quadrics (N, 10) at places (N, 3)."""
    x, y, z = at.T
    return np.asarray(
        x * (q[:, 0] * x + 2 * (q[:, 1] * y + q[:, 2] * z + q[:, 3]))
        + y * (q[:, 4] * y + 2 * (q[:, 5] * z + q[:, 6]))
        + z * (q[:, 7] * z + 2 * q[:, 8])
        + q[:, 9]
    )
