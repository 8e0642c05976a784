"""What is counted in COLMAP's models: images, not observations."""

from __future__ import annotations

from doubled import doubled_model

from colmap_ihe.colmap.checks.repeated_structure import _Points
from colmap_ihe.colmap.mapping import describe
from colmap_ihe.colmap.measures import images_seeing

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
