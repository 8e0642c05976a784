"""Find where photographs contradict a model: repeated structures, of which COLMAP took like parts for one.

Two signs, each between two photographs. *Blind*: photographs that the model puts side by side see the same points,
but for those that a detector misses now and then. Where like facades were taken for one, much of what each sees is
at a place where the other sees something else. That is the conflict of unique points of Heinly, Dunn and Frahm
(Correcting for Duplicate Scene Structure in Sparse 3D Reconstruction, ECCV 2014), between photographs so near each
other that occlusion does not explain it.

*Torn*: photographs whose verified matches are points of the model in both, and mostly not the same points. Either
the matches are of like parts, or the model put one place in two.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.field_of_view import pixels_of
from colmap_ihe.colmap.measures import images_seeing, strongest_pairs
from colmap_ihe.colmap.native import pycolmap

_F64 = NDArray[np.float64]

DOUBTFUL = 0.5
"""Share of points that a pair should share and does not, or shares and should not. Measured in docs/degenerate.md."""
_SHARE_OF_PAIRS, _LEAST_PAIRS = 0.05, 2
_NEIGHBOURS = 40  # of a photograph, by their places
_PAIRS = 2000
_DEGREES, _SCALE = 15.0, 1.5  # what is between two views of one thing that a detector finds again
_LEAST_COMMON, _LEAST_UNIQUE, _LEAST_MATCHED = 15, 15, 30
_LONG_TRACK = 3  # photographs; a point that fewer see is expected in no other
_DEPTHS, _AROUND = (2, 98), 1.2  # percentiles of what a photograph sees, and how far around them


@dataclass(frozen=True)
class Conflicts:
    """Name the pairs of grey images that contradict the model. Of `near` pairs that it puts side by side, `blind` are
    blind to much of what the other sees: to this share, which is `most` in any pair. Of `matched` pairs, `torn` have
    so many verified matches that are not the same points in the model."""

    near: int
    blind: tuple[tuple[str, str, float], ...]
    matched: int
    torn: tuple[tuple[str, str, int], ...]
    most: float = 0.0

    @property
    def many_blind(self) -> bool:
        """Return whether blind pairs are too many to be strays."""
        return _are_many(len(self.blind), self.near)

    @property
    def many_torn(self) -> bool:
        """Return whether torn pairs are too many to be strays."""
        return _are_many(len(self.torn), self.matched)


def _are_many(count: int, total: int) -> bool:
    return count >= max(_LEAST_PAIRS, _SHARE_OF_PAIRS * total)


@dataclass(frozen=True)
class _View:
    """Hold one image: `ids` (n,) of its points in order, `rows` (n,) of their coordinates, and its range of depth."""

    image: pycolmap.Image
    camera: pycolmap.Camera
    centre: _F64
    axis: _F64
    ids: NDArray[np.int64]
    rows: NDArray[np.intp]
    depths: tuple[float, float]


class _Points:
    def __init__(self, model: pycolmap.Reconstruction) -> None:
        points = sorted(model.points3D.items())
        self.ids = np.array([i for i, _ in points], np.int64)
        self.xyz = np.array([p.xyz for _, p in points], np.float64).reshape(-1, 3)
        self.is_long = np.array([images_seeing(p) >= _LONG_TRACK for _, p in points], bool)


def conflicts_of(folder: Path, database: Path) -> Conflicts:
    """Return the conflicts of the sparse model in `folder`, made from the matches in `database`."""
    model = pycolmap.Reconstruction(folder)
    points = _Points(model)
    views = [_view(model, model.images[i], points) for i in sorted(model.reg_image_ids())]
    views = [view for view in views if len(view.ids) >= _LEAST_COMMON]
    near, blind, most = 0, [], 0.0
    for first, second in _side_by_side(views):
        share = _share_unseen(views[first], views[second], points)
        if share is None:
            continue
        near, most = near + 1, max(most, share)
        if share > DOUBTFUL:
            blind.append((str(views[first].image.name), str(views[second].image.name), round(share, 3)))
    matched, torn = _torn(model, database)
    blind.sort(key=lambda b: (-b[2], b[:2]))
    torn.sort(key=lambda t: (-t[2], t[:2]))
    return Conflicts(near, tuple(blind), matched, tuple(torn), round(most, 3))


def _torn(model: pycolmap.Reconstruction, database: Path) -> tuple[int, list[tuple[str, str, int]]]:
    """Return the number of pairs that could be compared, and the torn ones with their matches."""
    point_of = {
        str(model.images[i].name): np.array(
            [p.point3D_id if p.has_point3D() else -1 for p in model.images[i].points2D], np.int64
        )
        for i in model.reg_image_ids()
    }
    compared, torn = 0, []
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: str(image.name) for image in opened.read_all_images()}
        for ids, matches in strongest_pairs(opened, _LEAST_MATCHED):
            first, second = (names[i] for i in ids)
            if first not in point_of or second not in point_of:
                continue
            ones, others = point_of[first][matches[:, 0]], point_of[second][matches[:, 1]]
            both = (ones >= 0) & (others >= 0)
            if np.count_nonzero(both) < _LEAST_MATCHED:
                continue
            compared += 1
            if np.count_nonzero(ones[both] != others[both]) > DOUBTFUL * np.count_nonzero(both):
                torn.append((first, second, len(matches)))
    return compared, torn


def _view(model: pycolmap.Reconstruction, image: pycolmap.Image, points: _Points) -> _View:
    ids = np.unique([p.point3D_id for p in image.get_observation_points2D()]).astype(np.int64)
    rows = np.searchsorted(points.ids, ids)
    pose = image.cam_from_world()
    depth = np.asarray(pose * points.xyz[rows])[:, 2] if len(rows) else np.zeros(1)
    near, far = np.percentile(depth, _DEPTHS)
    depths = (float(near) / _AROUND, float(far) * _AROUND)
    centre, axis = np.asarray(image.projection_center()), np.asarray(pose.rotation.matrix())[2]
    return _View(image, model.cameras[image.camera_id], centre, axis, ids, rows, depths)


def _side_by_side(views: list[_View]) -> list[tuple[int, int]]:
    """Return pairs of each view with its nearest, thinned out evenly where they are many."""
    pairs = set()
    centres = np.array([view.centre for view in views]).reshape(-1, 3)
    axes = np.array([view.axis for view in views]).reshape(-1, 3)
    for number, view in enumerate(views):
        away = np.linalg.norm(centres - view.centre, axis=1)
        alike = axes @ view.axis > np.cos(np.radians(2 * _DEGREES))
        away[~alike] = np.inf
        for other in np.argsort(away, kind="stable")[: _NEIGHBOURS + 1]:
            if other != number and np.isfinite(away[other]):
                pairs.add((min(number, int(other)), max(number, int(other))))
    ordered = sorted(pairs)
    return ordered[:: max(1, -(-len(ordered) // _PAIRS))]


def _share_unseen(first: _View, second: _View, points: _Points) -> float | None:
    """Return the share of the points both should see that only one sees, on the side where that is less; None where
    they share too little or look from too far apart."""
    common = np.intersect1d(first.ids, second.ids, assume_unique=True)
    if len(common) < _LEAST_COMMON:
        return None
    xyz = points.xyz[np.searchsorted(points.ids, common)]
    rays = [xyz - view.centre for view in (first, second)]
    away = [np.linalg.norm(ray, axis=1) for ray in rays]
    cosine = np.sum(rays[0] * rays[1], axis=1) / (away[0] * away[1])
    scale = float(np.median(away[0] / away[1]))
    if np.median(cosine) < np.cos(np.radians(_DEGREES)) or not 1 / _SCALE < scale < _SCALE:
        return None
    unique = min(_expected(first, second, points), _expected(second, first, points))
    return unique / (unique + len(common)) if unique >= _LEAST_UNIQUE else 0.0


def _expected(view: _View, other: _View, points: _Points) -> int:
    """Count the points that `view` sees and that `other` should see too, and does not."""
    rows = view.rows[~np.isin(view.ids, other.ids, assume_unique=True)]
    rows = rows[points.is_long[rows]]
    in_camera = np.asarray(other.image.cam_from_world() * points.xyz[rows]).reshape(-1, 3)
    in_camera = in_camera[(in_camera[:, 2] > other.depths[0]) & (in_camera[:, 2] < other.depths[1])]
    return int(np.count_nonzero(np.isfinite(pixels_of(other.camera, in_camera)[:, 0])))
