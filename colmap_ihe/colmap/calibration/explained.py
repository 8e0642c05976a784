"""Tell how many of the verified matches of a model's images fit its cameras and poses, also those without a point."""

from __future__ import annotations

import numpy as np

from colmap_ihe.colmap.native import pycolmap


def least_explained(
    model: pycolmap.Reconstruction, graph: pycolmap.CorrespondenceGraph, most_px: float
) -> float:
    """Return the share of an image's verified matches with other images of a model that lie within `most_px` of their
    epipolar line by the model's cameras and poses (Sampson's distance, in pixels of the smaller focal length): of up to
    ten images the smallest, of more that below which a tenth of them lie, as in a large set some image always has
    matches with a look-alike. Pairs were verified without a model: where an image was misplaced, its matches with most
    others lie elsewhere. 1 without matches."""
    image_ids = sorted(model.reg_image_ids())
    images = {i: model.images[i] for i in image_ids}
    cameras = {i: model.cameras[image.camera_id] for i, image in images.items()}
    rays = {
        i: np.asarray(cameras[i].cam_from_img(np.array([p.xy for p in image.points2D]).reshape(-1, 2)))
        for i, image in images.items()
    }
    right, matched = dict.fromkeys(image_ids, 0), dict.fromkeys(image_ids, 0)
    for pair in graph.image_pairs():
        first, second = pycolmap.pair_id_to_image_pair(pair)
        if first not in images or second not in images:
            continue
        rows = graph.extract_matches_between_images(first, second)
        moved = images[second].cam_from_world() * images[first].cam_from_world().inverse()
        squared = pycolmap.compute_squared_sampson_error(
            rays[first][rows[:, 0]], rays[second][rows[:, 1]], pycolmap.essential_matrix_from_pose(moved)
        )
        focal = min(cameras[i].mean_focal_length() for i in (first, second))
        fit = int(np.count_nonzero(np.asarray(squared) < (most_px / focal) ** 2))
        for i in (first, second):
            right[i] += fit
            matched[i] += len(rows)
    shares = sorted(right[i] / matched[i] for i in image_ids if matched[i])
    return shares[(len(shares) - 1) // 10] if shares else 1.0
