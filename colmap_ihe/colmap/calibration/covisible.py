"""Choose the images of a large model that its cameras are calibrated by: neighbours, so that they tie one another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from colmap_ihe.colmap.native import pycolmap


def covisible(model: pycolmap.Reconstruction, lenses: Sequence[Sequence[int]], most: int) -> list[int]:
    """Return the ids of all images of a model, or of about `most`, as many for each lens, whose cameras are given by
    their ids: from the image with most points on, always the one that shares most points with those chosen."""
    everything = sorted(model.reg_image_ids())
    if len(everything) <= most:
        return everything
    chosen: set[int] = set()
    for camera_ids in lenses:
        own = [i for i in everything if model.images[i].camera_id in camera_ids]
        chosen |= _grown(model, own, max(3, most // len(lenses)))
    return sorted(chosen)


def _grown(model: pycolmap.Reconstruction, image_ids: Sequence[int], most: int) -> set[int]:
    left = set(image_ids)
    chosen: set[int] = set()
    seen_by: dict[int, list[int]] = {}  # asking COLMAP for a track takes long
    shared: Counter[int] = Counter({i: model.images[i].num_points3D for i in image_ids})
    while left and len(chosen) < most:
        newest = max(sorted(left), key=lambda i: shared[i])
        if not chosen:
            shared.clear()
        chosen.add(newest)
        left.discard(newest)
        for point in model.images[newest].get_observation_points2D():
            if point.point3D_id not in seen_by:
                elements = model.points3D[point.point3D_id].track.elements
                seen_by[point.point3D_id] = [element.image_id for element in elements]
            shared.update(seen_by[point.point3D_id])
    return chosen
