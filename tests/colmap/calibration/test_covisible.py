"""The images of a large model that its cameras are calibrated by."""

from __future__ import annotations

from itertools import combinations

from wall_survey import camera, matches_of, survey

from colmap_ihe.colmap.calibration.covisible import covisible
from colmap_ihe.colmap.native import pycolmap


def test_all_images_of_a_small_model() -> None:
    model = survey([camera()], 5)
    assert covisible(model, [[1]], 5) == [1, 2, 3, 4, 5]
    model.deregister_frame(model.images[2].frame_id)
    assert covisible(model, [[1]], 4) == [1, 3, 4, 5]


def shared(model: pycolmap.Reconstruction) -> dict[tuple[int, int], int]:
    return {pair: len(rows) for pair, rows in matches_of(model).items()}


def test_as_many_as_asked_for_each_of_which_shares_points_with_one_before() -> None:
    # Narrow views: most share points with their neighbours alone.
    model = survey([camera(params=(9000, 600, 450, 0))], 24, points=20_000)
    common = shared(model)
    assert sum(count == 0 for count in common.values()) > 100
    chosen = covisible(model, [[1]], 7)
    assert len(chosen) == 7
    reached = {chosen[0]}
    for _ in chosen:
        reached |= {i for i in chosen if any(common[min(i, j), max(i, j)] > 5 for j in reached - {i})}
    assert reached == set(chosen)
    within = sum(common[pair] for pair in combinations(chosen, 2))
    neighbours = (sum(common[pair] for pair in combinations(range(i, i + 7), 2)) for i in range(1, 18))
    assert within > 0.9 * max(neighbours)


def test_each_lens_has_some_of_its_own() -> None:
    lenses = [camera(camera_id=1), camera(camera_id=2), camera(camera_id=3), camera(camera_id=4)]
    model = survey(lenses, 24)
    chosen = covisible(model, [[1], [2, 3]], 12)
    cameras = [model.images[i].camera_id for i in chosen]
    assert cameras.count(1) == 6
    assert sum(i in (2, 3) for i in cameras) == 6
    assert cameras.count(4) == 0
    assert len(covisible(model, [[1], [2], [3]], 6)) == 9  # three of each at least
    assert covisible(model, [], 6) == []
