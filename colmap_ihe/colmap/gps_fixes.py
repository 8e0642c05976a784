"""Tell which images have a GPS fix that says where they are."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.photographs.exif.blocks import is_place

Fix = tuple[float, float, float]
"""Latitude and longitude in degrees, altitude in metres."""


def forget_impossible_fixes(database: Path) -> None:
    """Take out of the database the fixes that no place has, which COLMAP would take for one."""
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for prior in opened.read_all_pose_priors():
            if prior.has_position() and not is_place(*map(float, prior.position)):
                prior.position = np.full(3, np.nan)
                opened.update_pose_prior(prior)


def useful_fixes(database: Path, neighbours: int | None = None) -> dict[int, Fix]:
    """Return the fixes by image that tell images apart: without those that so many share that the `neighbours` to
    compare, by default as many as COLMAP's, would all be found on the same spot, as where one fix was written into all
    photographs."""
    if neighbours is None:
        neighbours = int(pycolmap.SpatialPairingOptions().max_num_neighbors)
    with pycolmap.Database.open(database) as opened:
        priors = [prior for prior in opened.read_all_pose_priors() if prior.has_position()]
    fixes: dict[int, Fix] = {}
    for prior in priors:
        latitude, longitude, altitude = map(float, prior.position)
        fixes[int(prior.corr_data_id.id)] = (latitude, longitude, altitude)
    shared = Counter(fix[:2] for fix in fixes.values())
    most = max(1, neighbours // 2)
    return {image_id: fix for image_id, fix in fixes.items() if shared[fix[:2]] <= most}
