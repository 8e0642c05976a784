"""Choose the photographs that are matched with a reference."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from colmap_ihe.dense.camera import Float64, Int64, PinholeCamera
from colmap_ihe.dense.stereo.rectify import PairLeftOutError, rectify

# A shared point counts by the angle between its rays: too narrow is imprecise, too wide looks different.
ANGLES_DEG = (1.5, 3.0, 20.0, 35.0)
WORTH = (0.0, 1.0, 1.0, 0.0)


def choose_sources(
    reference: int,
    cameras: Mapping[int, PinholeCamera],
    points_world: Float64,
    seen_point: Int64,
    seen_by: Int64,
    count: int,
) -> tuple[list[int], dict[int, str]]:
    """Return the `count` cameras best suited to match with camera `reference`, best first, and the better ones that
    cannot be rectified with it, with the reason.

    `points_world` (N, 3), N >= 1, are the sparse points the reference sees; `seen_point` and `seen_by`
    (M,) say that the point in that row is seen by that camera too. A camera's score is the number of
    points it shares, each weighed by the angle between its rays (`ANGLES_DEG`, `WORTH`).
    """
    points = points_world[seen_point]
    to_reference = _unit(cameras[reference].centre - points)
    keys, camera_of = np.unique(seen_by, return_inverse=True)
    centres = np.array([cameras[key].centre for key in keys]).reshape(-1, 3)
    to_other = _unit(centres[camera_of] - points)
    cosines = np.clip((to_reference * to_other).sum(axis=1), -1, 1)
    worth = np.interp(np.degrees(np.arccos(cosines)), ANGLES_DEG, WORTH)
    sums = np.bincount(camera_of, worth, len(keys))
    scores = {int(key): float(total) for key, total in zip(keys, sums, strict=True) if key != reference}
    chosen: list[int] = []
    left_out: dict[int, str] = {}
    for other in sorted((key for key in scores if scores[key] > 0), key=lambda key: (-scores[key], key)):
        if len(chosen) == count:
            break
        try:
            rectify(cameras[reference], cameras[other], points_world)
            chosen.append(other)
        except PairLeftOutError as reason:
            left_out[other] = str(reason)
    return chosen, left_out


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
