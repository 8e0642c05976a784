"""The arrays of a model: what is in them follows from the scene that they are made of."""

from __future__ import annotations

import numpy as np
from wall_survey import camera, pixels_of, survey, whole_block

from colmap_ihe.colmap.calibration.block import part_of, thinned
from colmap_ihe.colmap.native import pycolmap


def test_points_lie_where_their_observations_are() -> None:
    lenses = [
        camera(),
        camera("OPENCV", (1100, 1090, 430, 610, 0.02, 0, 0.001, 0), camera_id=2, size=(900, 1200)),
    ]
    model = survey(lenses, 6)
    block, cameras = whole_block(model)
    assert len(block.points) == model.num_points3D()
    assert len(block.pixels) == model.compute_num_observations()
    assert block.cameras.tolist() == [0, 1, 0, 1, 0, 1]
    in_camera = block.in_camera()
    for place, lens in enumerate(cameras):
        mine = block.cameras[block.image] == place
        np.testing.assert_allclose(pixels_of(lens, in_camera[mine]), block.pixels[mine], atol=1e-9)
    lengths = np.diff(block.starts)
    assert lengths.min() >= 2
    assert np.array_equal(np.repeat(np.arange(len(lengths)), lengths), block.point)


def test_only_what_two_of_the_images_see_is_in_it() -> None:
    model = survey([camera()], 6)
    part = part_of(model, [2, 5], [1])
    block, ids = part.block, part.point_ids
    both = {i for i, point in model.points3D.items() if {2, 5} <= {e.image_id for e in point.track.elements}}
    assert set(ids.tolist()) == both
    assert (np.diff(block.starts) == 2).all()
    assert len(block.rotations) == 2


def test_of_two_observations_in_one_image_the_first_counts() -> None:
    model = survey([camera()], 4)
    point_id = next(i for i, p in model.points3D.items() if p.track.length() == 4)
    image = model.images[1]
    second = next(place for place, p in enumerate(image.points2D) if p.point3D_id != point_id)
    if image.points2D[second].has_point3D():
        model.delete_observation(1, second)
    model.add_observation(point_id, pycolmap.TrackElement(1, second))
    part = part_of(model, [1, 2, 3, 4], [1])
    block, ids = part.block, part.point_ids
    number = ids.tolist().index(point_id)
    rows = slice(block.starts[number], block.starts[number + 1])
    assert block.image[rows].tolist() == [0, 1, 2, 3]
    first = min(place for place, p in enumerate(image.points2D) if p.point3D_id == point_id)
    np.testing.assert_array_equal(block.pixels[rows][0], image.points2D[first].xy)


def test_points_and_observations_are_left_out() -> None:
    block, _ = whole_block(survey([camera()], 4))
    some = block.of_points(np.array([1, 4]))
    np.testing.assert_array_equal(some.points, block.points[[1, 4]])
    np.testing.assert_array_equal(some.pixels, block.pixels[np.isin(block.point, [1, 4])])
    assert set(some.point.tolist()) == {0, 1}
    kept = np.ones(len(block.pixels), bool)
    kept[block.starts[0] : block.starts[1] - 1] = False  # one of point 0 is left
    kept[block.starts[2]] = False
    less, numbers = block.of_observations(kept)
    gone = [0] if block.starts[3] - block.starts[2] > 2 else [0, 2]
    assert numbers.tolist() == [n for n in range(len(block.points)) if n not in gone]
    np.testing.assert_array_equal(less.points, block.points[numbers])
    none, numbers = block.of_observations(np.zeros(len(block.pixels), bool))
    assert (len(none.points), len(none.pixels), len(numbers)) == (0, 0, 0)


def test_the_longest_tracks_are_chosen_and_no_image_is_left_without() -> None:
    block, _ = whole_block(survey([camera()], 8, points=2000))
    last = block.image == 7
    others = (np.bincount(block.point[~last], minlength=len(block.points)) > 1)[block.point]
    alone = np.flatnonzero(np.bincount(block.point[last], minlength=len(block.points)))
    # The last image sees points that one other image sees, and those alone.
    first_of = np.zeros(len(block.pixels), bool)
    first_of[block.starts[alone]] = True
    mine = np.isin(block.point, alone)
    less, _ = block.of_observations(np.where(mine, last | first_of, others))
    lengths = np.diff(less.starts)
    chosen = thinned(less, 200)
    assert 200 <= len(chosen) <= 230
    seen = np.bincount(less.of_points(chosen).image, minlength=8)
    assert seen[7] == 30
    assert lengths[chosen].mean() > lengths.mean() + 1
    assert np.array_equal(thinned(less, len(less.points)), np.arange(len(less.points)))


def test_an_image_that_sees_little_keeps_it_all() -> None:
    block, _ = whole_block(survey([camera()], 8, points=1000))
    order = np.cumsum(block.image == 3)
    less, _ = block.of_observations((block.image != 3) | (order <= 12))
    chosen = thinned(less, 40)
    assert np.bincount(less.of_points(chosen).image, minlength=8)[3] == np.sum(less.image == 3) <= 12
    assert len(chosen) < len(less.points)
