"""The steps of the stereo room, each against something computed in another way."""

from __future__ import annotations

import numpy as np
import pytest
from planes import REFERENCE_SIZE, camera, plane, render, sparse_points

from colmap_ihe.dense.camera import Float32, Float64, PinholeCamera
from colmap_ihe.dense.stereo.match import match_around, match_whole_range
from colmap_ihe.dense.stereo.merge import enlarged, filled, merge, without_speckles
from colmap_ihe.dense.stereo.normals import normals_from_inverse_depth
from colmap_ihe.dense.stereo.rectify import PairLeftOutError, rectify
from colmap_ihe.dense.stereo.refine import compare, prepared, refined
from colmap_ihe.dense.stereo.sources import choose_sources
from colmap_ihe.dense.stereo.views import StereoView, sizes_coarse_to_fine

SLANTED = plane(4.0, 0.3, -0.2, (4.0, 4.0), seed=1)
REFERENCE = camera([0, 0, 0])
POINTS = np.random.default_rng(5).uniform([-1, -0.8, 3.5], [1, 0.8, 5.0], (60, 3))


def _pixels(points: Float64, seen_by: PinholeCamera) -> Float64:
    homogeneous = (points @ seen_by.rotation.T + seen_by.cam_from_world[:, 3]) @ seen_by.K.T
    return np.asarray(homogeneous / homogeneous[:, 2:])


@pytest.mark.parametrize(
    "source", [camera([0.5, 0, 0]), camera([-0.1, 0.6, 0.2], roll_deg=90), camera([1.2, 0.1, 0], yaw_deg=-15)]
)
def test_a_point_lies_on_one_row_and_its_disparity_gives_its_depth(source: PinholeCamera) -> None:
    pair = rectify(REFERENCE, source, POINTS)
    in_reference = _pixels(POINTS, REFERENCE) @ pair.from_reference.T
    in_source = _pixels(POINTS, source) @ pair.from_source.T
    left, right = in_reference / in_reference[:, 2:], in_source / in_source[:, 2:]
    assert left[:, 1] == pytest.approx(right[:, 1], abs=1e-8)
    disparity = left[:, 0] - right[:, 0]
    assert (disparity > pair.disparities[0]).all()
    assert (disparity < pair.disparities[1]).all()
    depth = pair.focal_px * pair.baseline * (left @ pair.depth_row) / disparity
    assert depth == pytest.approx(POINTS[:, 2], rel=1e-9)
    # A pixel of the reference covers about a pixel of the frame: nothing is stretched or thrown away.
    moved = (_pixels(POINTS, REFERENCE) + np.array([1, 0, 0])) @ pair.from_reference.T
    steps = np.linalg.norm((moved / moved[:, 2:] - left)[:, :2], axis=1)
    assert 0.7 < np.median(steps) < 1.4


def test_nothing_of_the_reference_is_cropped() -> None:
    pair = rectify(REFERENCE, camera([0.2, 0, 0], roll_deg=40), np.vstack([POINTS, POINTS * [1, 1, 3]]))
    everywhere = np.full(REFERENCE_SIZE[::-1], 0.25, np.float32)
    in_frame = pair.reference_in_frame(everywhere, 0)
    back = pair.to_reference(in_frame.astype(np.float32), REFERENCE_SIZE)
    assert (back > 0).mean() > 0.9
    assert back[back > 0] == pytest.approx(0.25, abs=1e-6)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (camera([0, 0, 0]), "same place"),
        (camera([0.1, 0, 0.6]), "9 degrees from a viewing direction"),
        (camera([0.5, 0, 0], yaw_deg=150), "opposite directions|looks away"),
        (camera([9.0, 0, 0]), "overlap in less than"),
    ],
)
def test_pairs_are_left_out_by_rule(source: PinholeCamera, reason: str) -> None:
    with pytest.raises(PairLeftOutError, match=reason):
        rectify(REFERENCE, source, POINTS)


def _maps(*values: float) -> list[Float32]:
    return [np.full((2, 3), value, np.float32) for value in values]


def test_merging_takes_the_majority() -> None:
    best, support = merge(_maps(0.5, 0.503, 0.9), [0.01, 0.01, 0.01])
    assert best == pytest.approx(np.full((2, 3), 0.5015), abs=1e-6)
    assert (support == 2).all()


def test_merging_weighs_by_precision_and_prefers_the_finest_alone() -> None:
    best, _ = merge(_maps(0.500, 0.506), [0.01, 0.005])
    assert best == pytest.approx(np.full((2, 3), (0.500 + 4 * 0.506) / 5), abs=1e-6)
    best, support = merge(_maps(0.5, 0.7, 0.0), [0.01, 0.005, 0.001])
    assert best == pytest.approx(np.full((2, 3), 0.7), abs=1e-6)
    assert (support == 1).all()
    assert not merge(_maps(0.0, 0.0), [0.01, 0.005])[1].any()


def test_holes_are_filled_between_their_rims() -> None:
    inverse = np.tile(np.linspace(1, 2, 64, dtype=np.float32), (64, 1))
    holed = inverse.copy()
    holed[20:40, 20:40] = 0
    result = filled(holed)
    assert result[holed > 0] == pytest.approx(inverse[holed > 0])
    inside = result[20:40, 20:40]
    assert inverse[0, 17] < inside.min()
    assert inside.max() < inverse[0, 43]
    with pytest.raises(ValueError, match="no pixel has a depth"):
        filled(np.zeros((4, 4), np.float32))


def test_nothing_is_between_the_two_sides_of_an_edge_when_depth_is_enlarged() -> None:
    slope = np.tile(np.linspace(0.1, 0.102, 12, dtype=np.float32), (6, 1))
    pole = slope.copy()
    pole[:, 5:7] = 0.2
    behind, larger = enlarged(slope, (24, 12)), enlarged(pole, (24, 12))
    assert np.diff(behind[5, 1:-1]) == pytest.approx(0.002 / 22, rel=1e-3)  # a slope has no steps
    assert (larger[:, 10:14] == np.float32(0.2)).all()
    assert larger[:, :10].max() < 0.103
    assert larger[:, 14:].max() < 0.103


def test_speckles_go_and_surfaces_stay() -> None:
    inverse = np.full((40, 40), 1.0, np.float32)
    inverse[10:14, 10:14] = 1.5
    inverse[20:, 20:] = 2.0
    kept = without_speckles(inverse, 30, one_pixel=0.01)
    assert not kept[10:14, 10:14].any()
    assert (kept[20:, 20:] == 2.0).all()
    assert np.count_nonzero(kept) == 1600 - 16


def test_normals_of_exact_planes_are_exact() -> None:
    for slope_x, slope_y in ((0.0, 0.0), (0.8, 0.0), (-0.5, 1.2)):
        _, depth = render(REFERENCE, [plane(4.0, slope_x, slope_y, (9.0, 9.0), seed=1)])
        inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-9), 0).astype(np.float32)
        normals = normals_from_inverse_depth(inverse, REFERENCE.K, 5)
        expected = np.array([slope_x, slope_y, -1]) / np.linalg.norm([slope_x, slope_y, -1])
        angles = np.degrees(np.arccos(np.clip(normals[depth > 0].astype(float) @ expected, -1, 1)))
        assert angles.max() < 0.3, f"{angles.max():.3f} degrees"


def test_refinement_takes_out_a_tenth_of_a_disparity_pixel() -> None:
    view, truth = render(REFERENCE, [SLANTED])
    sources = [render(camera([x, 0, 0]), [SLANTED])[0] for x in (-0.4, 0.4)]
    one_pixel = 1 / (420 * 0.4)
    exact = (1 / truth).astype(np.float32)
    start = exact + np.float32(0.4 * one_pixel)
    inverse = refined(prepared(view), sources, start, one_pixel, iterations=3)
    error_px = np.abs(inverse - exact)[20:-20, 60:-60] / one_pixel
    assert 0.001 < np.median(error_px) < 0.06, f"{np.median(error_px):.4f} pixels"


def test_a_pole_that_a_source_does_not_show_is_not_the_same_and_what_is_beside_it_is() -> None:
    """4 pixels wide, 12 levels darker than a wall, of which the source is brighter."""
    wall = np.random.default_rng(3).normal(120, 8, (60, 80))
    pole = wall.copy()
    pole[:, 40:44] -= 12
    cameras = camera([0, 0, 0], size=(80, 60))
    reference, source = (
        StereoView(cameras.K, cameras.cam_from_world, cameras.size, np.round(grey).astype(np.uint8))
        for grey in (pole, wall + 15)
    )
    same = compare(prepared(reference), source, np.full((60, 80), 0.25, np.float32)).same
    assert not same[:, 41:43].any()
    assert same[:, :39].all()
    assert same[:, 45:].all()


def test_sources_are_chosen_by_shared_points_and_angle() -> None:
    # Camera 4 shares only half of the points; 2 is too near, 5 too far, 6 has the baseline along the view.
    centres = [(0.0, 0.0), (0.02, 0.0), (0.5, 0.0), (0.8, 0.0), (4.0, 0.0), (0.1, 0.6)]
    cameras = {key: camera([x, 0, z]) for key, (x, z) in enumerate(centres, start=1)}
    pairs = np.array([(row, key) for key in cameras for row in range(0, len(POINTS), 2 if key == 4 else 1)])
    seen_point, seen_by = pairs.T
    chosen, left_out = choose_sources(1, cameras, POINTS, seen_point, seen_by, 4)
    assert chosen == [3, 4]
    assert list(left_out) == [6]
    assert choose_sources(1, cameras, POINTS, seen_point, seen_by, 1)[0] == [3]


def test_sizes_double() -> None:
    assert sizes_coarse_to_fine((1500, 1000), 400) == [(375, 250), (750, 500), (1500, 1000)]
    assert sizes_coarse_to_fine((300, 400), 400) == [(300, 400)]


def test_a_view_must_fit_its_camera() -> None:
    with pytest.raises(ValueError, match=r"expected \(300, 400\) uint8"):
        StereoView(REFERENCE.K, REFERENCE.cam_from_world, (400, 300), np.zeros((400, 300), np.uint8))


def test_a_smaller_view_sees_the_same() -> None:
    view, truth = render(REFERENCE, [SLANTED], noise=0)
    points = sparse_points(REFERENCE, truth)
    small = view.resized((200, 150))
    assert _pixels(points, small)[:, :2] == pytest.approx(_pixels(points, view)[:, :2] / 2)
    assert small.grey_u8[0, 0] == pytest.approx(view.grey_u8[:2, :2].mean(), abs=0.51)


def test_matching_leaves_out_what_the_source_does_not_see() -> None:
    front, back = plane(3.0, 0, 0, (0.5, 0.5), seed=2), plane(5.0, 0.1, 0, (5.0, 5.0), seed=3)
    source, _ = render(camera([0.4, 0, 0]), [front, back])
    view, truth = render(REFERENCE, [front, back])
    points = sparse_points(REFERENCE, truth)
    inverse = match_whole_range(rectify(REFERENCE, source, points), view, source)
    v, u = np.mgrid[:300, :400] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(REFERENCE.K).T
    in_source = _pixels((rays * truth[..., None]).reshape(-1, 3), source)[:, 0].reshape(300, 400)
    assert (inverse[in_source < -2] > 0).mean() < 0.1
    # Beside its left rim the front plane hides 22 columns of the back one from the source: only the check
    # from both sides finds that.
    hidden = (truth > 4) & (u > 107) & (u < 128) & (v > 85) & (v < 215)
    assert (inverse[hidden] > 0).mean() < 0.09, f"{(inverse[hidden] > 0).mean():.3f}"
    errors = np.abs(inverse[inverse > 0] * truth[inverse > 0] - 1)
    assert np.median(errors) < 0.01
    mask_u8 = np.full((300, 400), 255, np.uint8)
    mask_u8[:, 200:] = 0
    masked = StereoView(source.K, source.cam_from_world, source.size, source.grey_u8, mask_u8)
    inverse = match_whole_range(rectify(REFERENCE, source, points), view, masked)
    assert (inverse[in_source > 205] > 0).mean() < 0.02
    assert (inverse[(in_source > 20) & (in_source < 150)] > 0).mean() > 0.7


def test_matching_around_what_is_known_finds_the_rest() -> None:
    view, truth = render(REFERENCE, [SLANTED])
    source, _ = render(camera([0.4, 0, 0]), [SLANTED])
    pair = rectify(REFERENCE, source, sparse_points(REFERENCE, truth))
    one_pixel = 1 / (420 * 0.4)
    exact = (1 / truth).astype(np.float32)
    inverse = match_around(pair, view, source, exact + np.float32(5 * one_pixel))
    held = inverse > 0
    assert 0.7 < held.mean() < 1
    errors_px = np.abs(inverse - exact)[held] / one_pixel
    assert 0.001 < np.median(errors_px) < 0.2, f"{np.median(errors_px):.3f} pixels"
