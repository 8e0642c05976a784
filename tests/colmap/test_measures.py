"""What is counted in COLMAP's models: images, not observations."""

from __future__ import annotations

from pathlib import Path

import lenses
import numpy as np
import pytest
from doubled import doubled_model
from lenses import POSES, Lens, fisheye
from street import Street, name_of, write_street

from colmap_ihe.colmap.checks.repeated_structure import _Points
from colmap_ihe.colmap.mapping import describe
from colmap_ihe.colmap.measures import images_seeing, joined_by_matches, rms_px
from colmap_ihe.colmap.native import pycolmap

MODEL = doubled_model([1, 2, 3, 4], [1, 2, 3, 3], [1, 1, 2])


def test_an_image_with_two_observations_of_a_point_counts_once() -> None:
    assert [p.track.length() for _, p in sorted(MODEL.points3D.items())] == [4, 4, 3]
    assert [images_seeing(p) for _, p in sorted(MODEL.points3D.items())] == [4, 3, 2]


def test_points_over_three_views_are_seen_in_four_images() -> None:
    statistics = describe(MODEL)
    assert (statistics.points3d, statistics.points_over_3_views) == (3, 1)
    assert statistics.mean_track_length == (4 + 4 + 3) / 3  # as COLMAP counts


def test_a_point_that_two_images_see_is_expected_in_no_other() -> None:
    assert _Points(MODEL).is_long.tolist() == [True, True, False]


def test_the_error_of_a_model_of_several_lenses(tmp_path: Path) -> None:
    """All observations 0.3 pixels to the right and 0.4 down of where the point is, which is half a pixel."""
    chosen = [
        Lens("OPENCV", (330, 333), (-0.12, 0.03, 0.002, -0.001)),
        Lens("SIMPLE_RADIAL", (330, 330), (-0.1,)),
        fisheye(120, "RADIAL_FISHEYE", (-0.02, 0.004)),
        fisheye(100),
    ]
    model = lenses.model_of(dict(zip(POSES, chosen, strict=True)))
    model.write(tmp_path)
    assert rms_px(tmp_path) < 1e-6
    for image in model.images.values():
        for point in image.points2D:
            point.xy = point.xy + np.array([0.3, 0.4])
    model.write(tmp_path)
    assert rms_px(tmp_path) == pytest.approx(0.5)


def test_a_point_behind_a_camera_has_no_error(tmp_path: Path) -> None:
    model = doubled_model([1, 2], [1, 2], images=2)
    for image in model.images.values():
        for point in image.points2D:
            point.xy = image.project_point(model.points3D[point.point3D_id].xyz) + np.array([0.3, 0.4])
    model.points3D[1].xyz = np.array([0.0, 0.0, -9.0])
    model.write(tmp_path)
    assert rms_px(tmp_path) == pytest.approx(0.5)


def test_the_largest_group_that_matches_join(tmp_path: Path) -> None:
    """Of six photographs, 0 1 2 and 3 4 match, and 5 does so with none; 2 and 3 share 20 matches."""
    database = tmp_path / "database.db"
    write_street(Street(images=6, points=800), database)
    counts = {(0, 1): 40, (1, 2): 30, (2, 3): 20, (3, 4): 50}
    with pycolmap.Database.open(database) as opened:
        for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            one, other = pycolmap.pair_id_to_image_pair(pair)
            count = counts.get((one - 1, other - 1), 0)
            geometry.inlier_matches = np.zeros((count, 2), np.uint32)
            opened.update_two_view_geometry(one, other, geometry)
    assert joined_by_matches(database, 15) == 5
    assert joined_by_matches(database, 21) == 3
    assert joined_by_matches(database, 41) == 2
    assert joined_by_matches(database, 99) == 1
    assert joined_by_matches(database, 15, [name_of(number) for number in (0, 1, 3, 4)]) == 2
