"""What is counted in COLMAP's models: images, not observations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from doubled import doubled_model
from street import Street, name_of, write_street

from colmap_ihe.colmap.checks.repeated_structure import _Points
from colmap_ihe.colmap.mapping import describe
from colmap_ihe.colmap.measures import images_seeing, joined_by_matches
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
