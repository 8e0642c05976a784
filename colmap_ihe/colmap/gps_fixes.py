"""Tell which images have a GPS fix that says where they are."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.native import pycolmap

Fix = tuple[float, float, float]
"""Latitude and longitude in degrees, altitude in metres."""

NEIGHBOURS = int(pycolmap.SpatialPairingOptions().max_num_neighbors)
_FARTHEST = (90.0, 180.0)  # degrees north and east


def forget_impossible_fixes(database: Path) -> None:
    """Take out of the database the fixes that no place has: not finite, 0 degrees both north and east, as a receiver
    without satellites writes, or beyond a pole. COLMAP would take them for a place."""
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for prior in opened.read_all_pose_priors():
            if prior.has_position() and not _is_possible(tuple(prior.position)):
                prior.position = np.full(3, np.nan)
                opened.update_pose_prior(prior)


def _is_possible(fix: Sequence[float]) -> bool:
    latitude, longitude, altitude = fix
    if not all(map(math.isfinite, (latitude, longitude, altitude))) or latitude == longitude == 0:
        return False
    return abs(latitude) <= _FARTHEST[0] and abs(longitude) <= _FARTHEST[1]


def useful_fixes(database: Path, neighbours: int = NEIGHBOURS) -> dict[int, Fix]:
    """Return the fixes by image that tell images apart: without those that so many share that the `neighbours` to
    compare would all be found on the same spot, as where one fix was written into all photographs."""
    with pycolmap.Database.open(database) as opened:
        priors = [prior for prior in opened.read_all_pose_priors() if prior.has_position()]
    fixes: dict[int, Fix] = {}
    for prior in priors:
        latitude, longitude, altitude = map(float, prior.position)
        fixes[int(prior.corr_data_id.id)] = (latitude, longitude, altitude)
    shared = Counter(fix[:2] for fix in fixes.values())
    most = max(1, neighbours // 2)
    return {image_id: fix for image_id, fix in fixes.items() if shared[fix[:2]] <= most}
