"""Draw a textured mesh with fewer triangles, on some of its own vertices: arrays in, arrays out.

Points are drawn into a neighbour, cheapest first, by the quadric error of Garland and Heckbert (1997). The neighbour
stays where it is and keeps its place on the texture, so the texture stays right. Where patches of the texture meet, a
point has a vertex in each: it goes only along the border, each of its vertices within its own patch, so no crack
opens. Points at open borders stay. Many points go in one round, none beside another; which, is left to chance among the
cheaper ones.
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
    if len(faces) <= most:
        return faces
    used, rows = np.unique(faces, return_inverse=True)
    return np.asarray(used[_fewer(vertices[used], rows.reshape(-1, 3), most)])


def _fewer(vertices: npt.NDArray[np.floating], faces: Int64, most: int) -> Int64:
    places, point = np.unique(np.asarray(vertices, np.float64), axis=0, return_inverse=True)
    places, point = places - places[:1], point.ravel()
    quadrics = _quadrics(places, point[faces])
    locked = _at_borders(len(places), point[faces])
    chance = np.random.default_rng(0)
    for _ in range(_ROUNDS):
        excess = len(faces) - most
        if excess <= 0:
            break
        target = _one_round(places, point, faces, quadrics, locked, excess // 2 + 1, chance)
        moved = np.flatnonzero(target != np.arange(len(point)))
        gone, where = np.unique(point[moved], return_index=True)
        np.add.at(quadrics, point[target[moved[where]]], quadrics[gone])
        after = target[faces]
        after = after[(after != np.roll(after, 1, axis=1)).all(axis=1)]
        gain, faces = len(faces) - len(after), after
        if gain < _LEAST_GAIN * len(faces):
            break
    return faces


def _one_round(
    places: Float64,
    point: Int64,
    faces: Int64,
    quadrics: Float64,
    locked: Bool,
    most: int,
    chance: np.random.Generator,
) -> Int64:
    """Return (V,), the vertex that each is drawn into: itself, but for those of at most `most` points. Locks the points
    (P,) that would fold a triangle over."""
    start, end = _ways(point, faces, locked)
    cost = _errors(quadrics[point[start]], places[point[end]])
    best = np.full(len(places), np.inf)
    np.minimum.at(best, point[start], cost)
    is_best = cost == best[point[start]]
    onto = np.arange(len(places))
    onto[point[start[is_best]]] = point[end[is_best]]  # one of them, where several are as good
    is_best &= onto[point[start]] == point[end]
    limit = np.quantile(best[np.isfinite(best)], _SHARE) if len(cost) else 0.0
    chosen = best <= limit
    joined = point[faces]
    chosen &= _apart(joined, np.where(chosen, chance.permutation(len(places)), len(places)))
    folded = _folded(places, joined, onto, chosen)
    locked |= folded
    chosen &= ~folded
    by_cost = np.flatnonzero(chosen)[np.argsort(best[chosen], kind="stable")]
    chosen[by_cost[most:]] = False
    target = np.arange(len(point))
    goes = is_best & chosen[point[start]]
    target[start[goes]] = end[goes]
    return target


def _ways(point: Int64, faces: Int64, locked: Bool) -> tuple[Int64, Int64]:
    """Return the vertices (N,) that may go, and into which beside them. Where patches meet, only those all of whose
    point's vertices have one of the same neighbour's beside them."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    used = np.zeros(len(point), bool)
    used[faces] = True
    copies = np.bincount(point[used], minlength=len(locked))
    inside = (copies[point[start]] == 1) & ~locked[point[start]]
    between = copies[point] > 1
    at_seam = between[start] & between[end]
    ways = np.concatenate([np.stack([start, end])[:, at_seam], np.stack([end, start])[:, at_seam]], axis=1)
    first, second = np.divmod(np.unique(ways[0] * len(point) + ways[1]), len(point))
    _, pair, times = np.unique(
        point[first] * len(point) + point[second], return_inverse=True, return_counts=True
    )
    along = (times[pair] == copies[point[first]]) & ~locked[point[first]]
    return np.concatenate([start[inside], first[along]]), np.concatenate([end[inside], second[along]])


def _apart(faces: Int64, rank: Int64) -> Bool:
    """Return (P,): the points of lower rank than all of their neighbours."""
    ranks = rank[faces]
    beaten = np.zeros(len(rank), bool)
    beaten[faces[ranks > ranks.min(axis=1, keepdims=True)]] = True
    return np.asarray(~beaten)


def _folded(places: Float64, faces: Int64, target: Int64, chosen: Bool) -> Bool:
    """Return (P,): the chosen points of which a triangle would turn over or lose its area."""
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


def _at_borders(count: int, joined: Int64) -> Bool:
    """Return (P,): which of `count` points lie on an edge that is not of two of the triangles (F, 3) of points."""
    locked = np.zeros(count, bool)
    edges = np.sort(np.stack([joined, np.roll(joined, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, which, used = np.unique(edges @ np.array([count, 1]), return_inverse=True, return_counts=True)
    locked[edges[used[which] != 2]] = True
    return locked


def _normals(places: Float64, faces: Int64) -> Float64:
    corners = places[faces]
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _quadrics(places: Float64, faces: Int64) -> Float64:
    """Return (P, 10): the sum of the squared distances from the planes of a point's triangles, by area, as the upper
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
