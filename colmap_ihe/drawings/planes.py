"""Find the façades of a mesh: upright planes that much of its area lies in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Bool, Float64
from colmap_ihe.dense.texture.mesh import Mesh, face_normals
from colmap_ihe.drawings.frames import PlaneFrame, plane_frame
from colmap_ihe.drawings.surface import DrawnFaces

_UPRIGHT = 0.2  # cosine between up and the normal of a face of a wall
_BINS, _BLUR = 360, 4  # directions, and neighbours among which a wall is one
_APART = 30  # bins between two façades
_LIKE = np.cos(np.radians(12))  # cosine between normals of one wall
_OFFSETS = 400  # steps of depth over the extent, in which the plane is looked for
_LEAST_SHARE = 0.25  # of the area of the largest façade
_ROUNDS = 8  # of the fit
_SHARE_OUTSIDE = 0.001  # of the area, that may lie beyond each edge of a drawing
_FACING = 0.3  # cosine between a normal and the drawing, of what the drawing is of
_SIDES = ("front", "right", "back", "left")


@dataclass(frozen=True)
class Facade:
    """Hold a façade that was found: a name, its plane, and the area of the faces that look its way."""

    name: str
    frame: PlaneFrame
    area: float


def find_facades(mesh: Mesh, up: Float64) -> list[Facade]:
    """Return the façades of a mesh, the largest first: upright planes, each through the depth at which most of its
    faces lie. The largest is the front, others are named by where they look, as seen by somebody before the front."""
    normals = face_normals(mesh.corners())
    length = np.linalg.norm(normals, axis=1)
    area = length / 2
    unit = normals / np.maximum(length, 1e-300)[:, None]
    east, north = _level_axes(up)
    wall = np.abs(unit @ up) < _UPRIGHT
    if not wall.any() or not area[wall].any():
        return []
    angle = np.arctan2(unit @ north, unit @ east)
    middles = mesh.corners().mean(axis=1, dtype=np.float64)
    found: list[tuple[float, PlaneFrame]] = []
    for direction in _directions(angle[wall], area[wall]):
        normal = np.cos(direction) * east + np.sin(direction) * north
        like = wall & (unit @ normal > _LIKE)
        frame = _plane(middles[like], area[like], normal, up)
        found.append((float(area[like].sum()), frame))
    found.sort(key=lambda item: -item[0])
    found = [item for item in found if item[0] >= _LEAST_SHARE * found[0][0]]
    return _named(found)


def _level_axes(up: Float64) -> tuple[Float64, Float64]:
    first = np.array((1.0, 0.0, 0.0)) if abs(up[0]) < 0.9 else np.array((0.0, 1.0, 0.0))
    east = first - (first @ up) * up
    east /= np.linalg.norm(east)
    return east, np.cross(up, east)


def _directions(angle: Float64, area: Float64) -> list[float]:
    """Return the directions in which most area looks, in radians, far apart from each other."""
    counts, _ = np.histogram(angle, _BINS, (-np.pi, np.pi), weights=area)
    window = np.hanning(2 * _BLUR + 3)[1:-1]
    padded = np.concatenate((counts[-_BLUR:], counts, counts[:_BLUR]))
    smooth = np.convolve(padded, window / window.sum(), "valid")
    chosen: list[float] = []
    rest = smooth.copy()
    while rest.max() > _LEAST_SHARE / 2 * smooth.max():
        best = int(rest.argmax())
        chosen.append(-np.pi + (best + 0.5) * 2 * np.pi / _BINS)
        rest[(best + np.arange(-_APART, _APART + 1)) % _BINS] = 0
    return chosen


def _plane(middles: Float64, area: Float64, normal: Float64, up: Float64) -> PlaneFrame:
    """Return the upright plane in which most of a wall lies: least squares over the faces near it, by area, each round
    with those that are nearer."""
    depth = middles @ normal
    extent = max(float(np.ptp(middles, axis=0).max()), 1e-12)
    near = extent / _OFFSETS
    bins = max(1, int(np.ptp(depth) / near))
    counts, edges = np.histogram(depth, bins, weights=area)
    counts = np.convolve(counts, np.ones(3), "same")
    best = int(counts.argmax())
    offset = float((edges[best] + edges[best + 1]) / 2)
    side = np.cross(up, normal)
    slope = 0.0
    for _ in range(_ROUNDS):
        across = middles @ side
        away = depth - offset - slope * across
        close = np.abs(away) < 2 * near
        weight = np.sqrt(area[close])
        system = np.stack((np.ones(close.sum()), across[close]), axis=1) * weight[:, None]
        (offset, slope), *_ = np.linalg.lstsq(system, depth[close] * weight, rcond=None)
        near = max(near * 0.7, extent / 4000)
    direction = normal - slope * side
    length = float(np.linalg.norm(direction))
    middle = middles[close].mean(axis=0) if close.any() else middles.mean(axis=0)
    unit = direction / length
    point = middle + (offset / length - middle @ unit) * unit
    return plane_frame(point, unit, up)


def _named(found: list[tuple[float, PlaneFrame]]) -> list[Facade]:
    facades: list[Facade] = []
    front = found[0][1]
    for area, frame in found:
        turned = np.degrees(np.arctan2(frame.normal @ front.right, frame.normal @ front.normal))
        name = _SIDES[round(float(turned) / 90) % 4]
        same = sum(f.name.split("-")[0] == name for f in facades)
        facades.append(Facade(f"{name}-{same + 1}" if same else name, frame, area))
    return facades


def extent_of(faces: DrawnFaces) -> tuple[float, float, float, float]:
    """Return left, bottom, right and top of what a drawing is of: of the faces that look its way, but for a small share
    of their area at each edge. Raises ValueError where there are none."""
    corners = faces.corners
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    length = np.linalg.norm(normal, axis=1)
    facing: Bool = np.asarray(normal[:, 2] > _FACING * np.maximum(length, 1e-300))
    if not facing.any():
        raise ValueError("no face of the mesh looks to the drawing")
    weight = normal[facing, 2]
    low, high = corners[facing].min(axis=1), corners[facing].max(axis=1)
    left, bottom = (_quantile(low[:, k], weight, _SHARE_OUTSIDE) for k in (0, 1))
    right, top = (_quantile(high[:, k], weight, 1 - _SHARE_OUTSIDE) for k in (0, 1))
    return left, bottom, right, top


def _quantile(values: Float64, weight: Float64, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][min(int(np.searchsorted(total, share * total[-1])), len(order) - 1)])
