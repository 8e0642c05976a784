"""A model of which some points have two observations in one image."""

from __future__ import annotations

import numpy as np

from colmap_ihe.colmap.native import pycolmap


def doubled_model(*images_of_points: list[int], images: int = 4) -> pycolmap.Reconstruction:
    """Points with an observation in each of the images named, which may be named twice; images count from 1."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 100.0, 100, 80)
    model.add_camera_with_trivial_rig(camera)
    tracks = [pycolmap.Track() for _ in images_of_points]
    for number in range(1, images + 1):
        rows = [n for n, seen_by in enumerate(images_of_points) for i in seen_by if i == number]
        places = np.array([(10.0 + n, 40.0) for n in range(len(rows))]).reshape(-1, 2)
        image = pycolmap.Image(name=f"{number}.png", keypoints=places, camera_id=1, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.4 * number, 0, 4.0]))
        model.add_image_with_trivial_frame(image, pose)
        for index, row in enumerate(rows):
            tracks[row].add_element(number, index)
    for number, track in enumerate(tracks):
        model.add_point3D(
            np.array([0.02 * number, 0.01 * number, 0.01 * number]), track, np.zeros(3, np.uint8)
        )
    return model
