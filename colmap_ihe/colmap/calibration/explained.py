"""Tell how many of the verified matches of a model's images fit its cameras and poses, also those without a point."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from colmap_ihe.colmap.native import pycolmap


def least_explained(
    model: pycolmap.Reconstruction, graph: pycolmap.CorrespondenceGraph, most_px: float
) -> float:
    """Return the smallest share of any registered image's verified matches with other registered images that lie within
    `most_px` of their epipolar line by the model's cameras and poses (Sampson's distance, in pixels of the smaller
    focal length). Pairs were verified without a model: where an image was misplaced, its matches with most others lie
    elsewhere. 1 without matches."""
    image_ids = sorted(model.reg_image_ids())
    images = [model.images[i] for i in image_ids]
    rays = [
        np.asarray(
            model.cameras[image.camera_id].cam_from_img(
                np.array([p.xy for p in image.points2D]).reshape(-1, 2)
            )
        )
        for image in images
    ]
    right, matched = np.zeros(len(images)), np.zeros(len(images))
    for first, second in combinations(range(len(images)), 2):
        pairs = graph.extract_matches_between_images(image_ids[first], image_ids[second])
        if len(pairs) == 0:
            continue
        moved = images[second].cam_from_world() * images[first].cam_from_world().inverse()
        squared = pycolmap.compute_squared_sampson_error(
            rays[first][pairs[:, 0]], rays[second][pairs[:, 1]], pycolmap.essential_matrix_from_pose(moved)
        )
        focal = min(model.cameras[images[k].camera_id].mean_focal_length() for k in (first, second))
        fit = np.count_nonzero(np.asarray(squared) < (most_px / focal) ** 2)
        right[[first, second]] += fit
        matched[[first, second]] += len(pairs)
    seen = matched > 0
    return float((right[seen] / matched[seen]).min(initial=1.0))
