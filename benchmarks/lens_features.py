"""Scatter features on panels, and tell which of them photographs find, where, and which pairs match them.

The figures are such that pairs match as on real sets (fountain-p11 and sceaux at 1600 pixels): of the features of a
photograph a pair matches 24 to 50 % where the view turns by 10 degrees, 14 to 31 % at 20, 5 to 18 % at 35 and 1 to 3 %
at 70; large features are found less exactly than small ones, by a factor of 2 to 3, and tails are long.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import combinations
from typing import Any

import numpy as np
from lens_scenes import Floats, Panels
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

Truths = NDArray[np.bool_]
Indices = NDArray[np.intp]

SMALLEST_PX = 1.8  # scale of the smallest features of SIFT
_FACING = float(np.cos(np.radians(70)))
_TURN, _OCTAVE = (
    np.radians(13),
    np.radians(20),
)  # how far a feature is known again; what a doubled distance counts
_CLUTTER = 0.25  # share of features that one photograph alone has: leaves, sky, reflections
_FOUND, _MATCHED, _WRONG, _WRONG_AT_LEAST = 0.9, 0.9, 0.05, 0.004
_CLASSES, _SHARES = np.array([0.35, 0.8, 2.0]), np.array([0.7, 0.25, 0.05])
_DISORDER = 0.8  # standard deviation of log scale by which the classes of noise mix
_DRIFT, _DRIFT_TURN = (
    0.3,
    np.radians(20),
)  # share of the noise that stays in neighbouring views; how long it does
_PILOT = 20_000


@dataclass(frozen=True)
class Features:
    """Hold n features: (n, 3) points and normals, (n,) sizes in metres, (n,) angles within which they are known again,
    (n, 2, 4) how their place drifts with the direction of view, along the surface."""

    points: Floats
    normals: Floats
    sizes: Floats
    known: Floats
    drift: Floats

    def of(self, chosen: NDArray[Any]) -> Features:
        return Features(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True)
class Sightings:
    """Hold the features of a place that are seen, from where (images, n, 4), and by which photographs they are found
    (images, n)."""

    features: Features
    looks: Floats
    found: Truths


def ray_angles(camera: pycolmap.Camera, pixels: Floats) -> Floats:
    """Return the angles off the axis of (n, 2) pixels in radians."""
    rays = np.asarray(camera.cam_from_img(pixels))
    return np.asarray(np.arctan(np.linalg.norm(rays, axis=1)))


def centre_of(pose: Floats) -> Floats:
    """Return the centre (3,) of a camera by its cam_from_world (3, 4)."""
    return np.asarray(-pose[:, :3].T @ pose[:, 3])


def sight(
    panels: Panels, camera: pycolmap.Camera, poses: list[Floats], each: int, rng: np.random.Generator
) -> Sightings:
    """Scatter as many features as it takes for `each` in a photograph, and find them in all photographs."""
    centres = np.array([centre_of(pose) for pose in poses])
    smallest = SMALLEST_PX * _nearest(panels, centres) / camera.mean_focal_length()

    def sightings(number: int) -> Sightings:
        features = _scatter(panels, number, smallest, rng)
        visible = np.array([_visible(features, camera, pose, panels) for pose in poses])
        seen = np.flatnonzero(visible.any(axis=0))
        features = features.of(seen)
        looks = _looks(features, centres)
        return Sightings(features, looks, _found(visible[:, seen], looks, features.known, rng))

    share = max(int(sightings(_PILOT).found.sum()), 1) / _PILOT
    return sightings(int(each * len(poses) / share))


def _nearest(panels: Panels, centres: Floats) -> Floats:
    """Return the distance of each panel from the nearest camera, (n,), of two metres at least."""
    nearest = np.full(len(panels.corner), np.inf)
    for centre in centres:
        offset = centre - panels.corner
        foot = panels.corner.copy()
        for edge in (panels.across, panels.up):
            along = np.einsum("ij,ij->i", offset, edge) / np.einsum("ij,ij->i", edge, edge)
            foot += along.clip(0, 1)[:, None] * edge
        nearest = np.minimum(nearest, np.linalg.norm(centre - foot, axis=1))
    return np.asarray(np.maximum(nearest, 2.0))


def _scatter(panels: Panels, number: int, smallest: Floats, rng: np.random.Generator) -> Features:
    """Scatter features on panels by their texture. Their sizes are as many at every scale (Pareto), from the `smallest`
    of each panel in metres: what is smaller no photograph could find."""
    weight = panels.area * panels.texture / smallest**2
    panel = rng.choice(len(weight), number, p=weight / weight.sum())
    share = rng.uniform(size=(number, 2))
    points = panels.corner[panel] + share[:, :1] * panels.across[panel] + share[:, 1:] * panels.up[panel]
    sizes = smallest[panel] / np.sqrt(1 - rng.uniform(0, 0.9999, number))
    known = _TURN * rng.lognormal(0, 1, number) * np.where(rng.uniform(size=number) < _CLUTTER, 1e-3, 1)
    waves, phases = rng.normal(0, 1 / _DRIFT_TURN, (number, 2, 3)), rng.uniform(0, 2 * np.pi, (number, 2, 1))
    return Features(points, panels.normal[panel], sizes, known, np.concatenate([waves, phases], axis=2))


def _hidden(points: Floats, centre: Floats, panels: Panels, chunk: int = 250) -> Truths:
    """Tell which of (n, 3) points lie behind a panel that faces `centre`."""
    corner = panels.corner - centre
    ahead = np.einsum("ij,ij->i", panels.normal, corner)
    facing = ahead < 0
    corner, ahead = corner[facing], ahead[facing].astype(np.float32)
    edges = [
        edge[facing] / (edge[facing] ** 2).sum(axis=1, keepdims=True) for edge in (panels.across, panels.up)
    ]
    begins = [np.einsum("ij,ij->i", edge, corner).astype(np.float32) for edge in edges]
    normal_t = panels.normal[facing].T.astype(np.float32)
    hidden = np.zeros(len(points), bool)
    for begin in range(0, len(points), chunk):
        rays = (points[begin : begin + chunk] - centre).astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            reach = ahead / (rays @ normal_t)
            inside = (reach > 0) & (reach < 0.999)
            for edge, first in zip(edges, begins, strict=True):
                along = reach * (rays @ edge.T.astype(np.float32)) - first
                inside &= (along >= 0) & (along <= 1)
        hidden[begin : begin + chunk] = inside.any(axis=1)
    return hidden


def _visible(features: Features, camera: pycolmap.Camera, pose: Floats, panels: Panels) -> Truths:
    """Tell which features a photograph shows, large enough to be found, (n,)."""
    centre = centre_of(pose)
    local = features.points @ pose[:, :3].T + pose[:, 3]
    rays = features.points - centre
    distance = np.linalg.norm(rays, axis=1)
    facing = -np.einsum("ij,ij->i", rays, features.normals) > _FACING * distance
    large = features.sizes * camera.mean_focal_length() > SMALLEST_PX * distance
    corners = np.array([[0.0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]])
    ahead = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2]) <= ray_angles(camera, corners).max()
    chosen = np.flatnonzero(facing & large & ahead)
    pixels = np.asarray(camera.img_from_cam(local[chosen])).reshape(-1, 2)
    chosen = chosen[((pixels > 0) & (pixels < (camera.width, camera.height))).all(axis=1)]
    visible = np.zeros(len(local), bool)
    visible[chosen[~_hidden(features.points[chosen], centre, panels)]] = True
    return visible


def _looks(features: Features, centres: Floats) -> Floats:
    """Return from where each feature is seen, (images, n, 4): direction, and the distance's octaves as an angle."""
    rays = features.points[None] - centres[:, None]
    distance = np.linalg.norm(rays, axis=2, keepdims=True)
    return np.concatenate([rays / distance, _OCTAVE * np.log2(distance)], axis=2)


def _found(visible: Truths, looks: Floats, known: Floats, rng: np.random.Generator) -> Truths:
    """Tell which features each photograph finds (images, n): one photograph, by lot, shows a feature at its best."""
    best = (rng.uniform(size=visible.shape) * visible).argmax(axis=0)
    apart = np.linalg.norm(looks - looks[best, np.arange(len(known))], axis=2) / known
    return np.asarray((rng.uniform(size=visible.shape) < _FOUND * np.exp(-0.5 * apart**2)) & visible)


def _spread(scale: Floats, noise_px: float, rng: np.random.Generator) -> Floats:
    """Draw the standard deviation of the place of each feature in pixels: in classes, by its scale and by chance."""
    rank = (scale * rng.lognormal(0, _DISORDER, len(scale))).argsort().argsort() / max(len(scale), 1)
    classes = np.searchsorted(_SHARES.cumsum()[:2], rank, side="right")
    return np.asarray(_CLASSES[classes] * noise_px / (_CLASSES @ _SHARES))


def keypoints(
    features: Features, camera: pycolmap.Camera, pose: Floats, noise_px: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return where features are found, (n, 4) as COLMAP stores them: x, y, scale and orientation.

    Large features are found less exactly. A part of each mistake is the feature's own and drifts along its surface with
    the direction of view, as a detector's on a real relief does."""
    rays = features.points - centre_of(pose)
    distance = np.linalg.norm(rays, axis=1)
    scale = camera.mean_focal_length() * features.sizes / distance
    spread = _spread(scale, noise_px, rng)
    waves = (
        np.einsum("nki,ni->nk", features.drift[..., :3], rays / distance[:, None]) + features.drift[..., 3]
    )
    shift = np.sqrt(2 * _DRIFT) * np.sin(waves) * (spread * distance / camera.mean_focal_length())[:, None]
    first = np.cross(features.normals, (0.36, 0.48, 0.8))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    points = features.points + shift[:, :1] * first + shift[:, 1:] * np.cross(features.normals, first)
    exact = np.asarray(camera.img_from_cam(points @ pose[:, :3].T + pose[:, 3])).reshape(-1, 2)
    places = exact + np.sqrt(1 - _DRIFT) * spread[:, None] * rng.normal(size=exact.shape)
    return np.column_stack([places, scale, np.zeros(len(scale))]).astype(np.float32)


def matches(
    rows: list[Indices], looks: Floats, known: Floats, rng: np.random.Generator
) -> Iterator[tuple[int, int, NDArray[np.uint32]]]:
    """Match the features of each pair of photographs, the less the more the view has turned; some are wrong.

    `rows`: by photograph, the features that it finds, in the order of its keypoints."""
    for first, second in combinations(range(len(rows)), 2):
        shared, left, right = np.intersect1d(
            rows[first], rows[second], assume_unique=True, return_indices=True
        )
        apart = np.linalg.norm(looks[first, shared] - looks[second, shared], axis=1) / (1.5 * known[shared])
        kept = rng.uniform(size=len(shared)) < _MATCHED * np.exp(-0.5 * apart**2)
        left, right = left[kept], right[kept]
        wrong = int(_WRONG * len(left)) + int(_WRONG_AT_LEAST * len(rows[first]))
        mistakes = [
            rng.permutation(np.setdiff1d(np.arange(len(rows[image])), used))[:wrong]
            for image, used in ((first, left), (second, right))
        ]
        wrong = min(len(mistake) for mistake in mistakes)
        pair = np.column_stack([np.append(left, mistakes[0][:wrong]), np.append(right, mistakes[1][:wrong])])
        yield first, second, rng.permutation(pair).astype(np.uint32)
