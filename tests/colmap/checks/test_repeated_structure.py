"""What one photograph sees and another should see too."""

from __future__ import annotations

import numpy as np
from lenses import Lens

from colmap_ihe.colmap.checks import repeated_structure
from colmap_ihe.colmap.native import pycolmap


def test_a_point_that_a_lens_folds_back_is_expected_in_no_picture() -> None:
    """At 57 degrees from the axis of a barrel lens: its formula puts the point into the picture, 26 degrees from it."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(Lens("SIMPLE_RADIAL", (300, 300), (-0.3,), off=(0, 0)).camera(1))
    heights = np.linspace(-0.5, 0.5, 40)
    aside = np.column_stack([np.full(40, 4 * 1.52365), heights, np.full(40, 4.0)])
    ahead = np.column_stack([heights, heights, np.full(40, 4.0)])
    for number in range(1, 5):
        image = pycolmap.Image(
            name=f"{number}.png", keypoints=np.full((40, 2), 100.0), camera_id=1, image_id=number
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    for places, seen_by in ((ahead, (4,)), (aside, (1, 2, 3))):
        for row, point in enumerate(places):
            track = pycolmap.Track()
            for number in seen_by:
                track.add_element(number, row)
            model.add_point3D(point, track, np.zeros(3, np.uint8))
    points = repeated_structure._Points(model)
    first, other = (repeated_structure._view(model, model.images[n], points) for n in (1, 4))
    pixels = np.asarray(other.camera.img_from_cam(aside))
    assert ((pixels > 0) & (pixels < (320, 240))).all()
    assert repeated_structure._expected(first, other, points) == 0
