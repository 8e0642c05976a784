"""Depth from rendered planes, against the planes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from planes import Plane, camera, plane, render, sparse_points

from colmap_ihe.dense.camera import Float64, PinholeCamera
from colmap_ihe.dense.stereo import depth as depth_module
from colmap_ihe.dense.stereo import refine as refine_module
from colmap_ihe.dense.stereo.depth import DepthResult, depth_and_normals, first_step
from colmap_ihe.dense.stereo.rectify import rectify
from colmap_ihe.dense.stereo.views import sizes_coarse_to_fine
from colmap_ihe.errors import Cancelled

SLANTED = plane(4.0, 0.3, -0.2, (4.0, 4.0), seed=1)
REFERENCE = camera([0, 0, 0])


def _reconstructed(
    sources: list[PinholeCamera], *planes: Plane, noise: float = 1.0, **changes: Any
) -> tuple[DepthResult, Float64]:
    """Return what `sources` give for the reference, with `changes` to its view, and its true depth."""
    view, truth = render(REFERENCE, planes, noise)
    views = [render(source, planes, noise)[0] for source in sources]
    return depth_and_normals(replace(view, **changes), views, sparse_points(REFERENCE, truth)), truth


def _errors(result: DepthResult, truth: Float64) -> NDArray[np.float64]:
    held = (result.depth > 0) & (truth > 0)
    return np.abs(result.depth[held] / truth[held] - 1)


def _coverage(result: DepthResult) -> float:
    return float((result.depth > 0).mean())


@pytest.mark.parametrize(
    ("source", "coverage"),
    [
        pytest.param(camera([0.5, 0, 0]), (0.75, 0.9), id="to the right"),
        pytest.param(camera([-0.5, 0, 0]), (0.75, 0.9), id="to the left"),
        pytest.param(camera([0, 0.5, 0]), (0.7, 0.88), id="vertical baseline"),
        pytest.param(camera([0.35, -0.35, 0]), (0.65, 0.85), id="diagonal baseline"),
        pytest.param(camera([0.4, 0, 0], roll_deg=90, size=(300, 400)), (0.75, 0.95), id="portrait"),
        pytest.param(camera([0.4, 0, 0], roll_deg=180), (0.75, 0.95), id="upside down"),
        pytest.param(camera([1.2, 0, 0.2], yaw_deg=-17), (0.85, 1.0), id="convergent"),
        pytest.param(camera([0.4, 0, -0.3], focal=300), (0.8, 1.0), id="another focal length"),
    ],
)
def test_one_source(source: PinholeCamera, coverage: tuple[float, float]) -> None:
    result, truth = _reconstructed([source], SLANTED)
    errors = _errors(result, truth)
    assert not result.pairs_left_out
    # An error of half a pixel in a convention would show; so would truth that leaked in.
    disparity_px = source.K[0, 0] * np.linalg.norm(source.centre) / 4.0
    median_px = float(np.median(errors) * disparity_px)
    assert 0.002 < median_px < 0.1, f"median {median_px:.4f} pixels"
    assert np.percentile(errors, 95) < 0.015, f"95 % {np.percentile(errors, 95):.5f}"
    assert coverage[0] < _coverage(result) < coverage[1], f"coverage {_coverage(result):.3f}"


def test_more_sources_cover_more_and_are_more_precise() -> None:
    near = [camera([x, 0, 0]) for x in (-0.4, 0.4)]
    one, truth = _reconstructed(near[:1], SLANTED)
    two, _ = _reconstructed(near, SLANTED)
    assert _coverage(two) > _coverage(one) + 0.05
    assert np.median(_errors(two, truth)) < np.median(_errors(one, truth))


def test_a_step_in_depth_is_where_it_should_be() -> None:
    front, back = plane(3.0, 0, 0, (0.5, 0.5), seed=2), plane(5.0, 0.1, 0, (5.0, 5.0), seed=3)
    sources = [camera([x, y, 0]) for x, y in ((-0.4, 0), (0.4, 0), (0, 0.4), (0, -0.4))]
    result, truth = _reconstructed(sources, front, back)
    errors = _errors(result, truth)
    assert _coverage(result) > 0.85
    # The rim of the front plane is 4 x 140 of 120,000 pixels: some beside it may be taken for it.
    assert 0.0 < (errors > 0.05).mean() < 0.015, f"{(errors > 0.05).mean():.4f}"
    assert np.median(errors) < 0.001


def test_normals_of_a_slanted_plane() -> None:
    result, _ = _reconstructed([camera([-0.5, 0, 0]), camera([0.5, 0, 0])], SLANTED)
    held = result.depth > 0
    normals = result.normals[held].astype(float)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-4)
    angles = np.degrees(np.arccos(np.clip(normals @ SLANTED.normal, -1, 1)))
    assert np.median(angles) < 2.0, f"{np.median(angles):.2f} degrees"
    assert np.percentile(angles, 90) < 6.0, f"{np.percentile(angles, 90):.2f} degrees"
    assert not result.normals[~held].any()


def test_a_forward_moving_pair_is_left_out_with_its_reason() -> None:
    result, _ = _reconstructed([camera([0.05, 0, 0.5]), camera([0.4, 0, 0])], SLANTED)
    assert list(result.pairs_left_out) == [0]
    assert "degrees from a viewing direction" in result.pairs_left_out[0]


def test_without_a_usable_source_the_maps_are_empty() -> None:
    result, _ = _reconstructed([camera([0, 0, 0])], SLANTED)
    assert "same place" in result.pairs_left_out[0]
    assert not result.depth.any()
    assert not result.normals.any()
    assert result.depth.shape == (300, 400)


def test_what_was_not_photographed_gets_no_depth() -> None:
    small = plane(4.0, 0, 0, (0.9, 0.7), seed=4)
    result, truth = _reconstructed([camera([-0.4, 0, 0]), camera([0.4, 0, 0])], small)
    assert (result.depth[truth > 0] > 0).mean() > 0.85
    # The window of 7 pixels reaches over the rim.
    assert (result.depth[truth == 0] > 0).mean() < 0.05


def test_a_nearly_plain_wall_is_kept_where_sources_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    pale = replace(SLANTED, texture_u8=(120 + SLANTED.texture_u8.astype(float) / 60).astype(np.uint8))
    sources = [camera([x, 0, 0]) for x in (-0.4, 0.4, -0.2, 0.2)]
    monkeypatch.setattr(depth_module, "_MIN_VARIANCE", 0.5)
    kept, truth = _reconstructed(sources, pale, noise=0.7)
    monkeypatch.setattr(depth_module, "_MIN_VARIANCE", 1e9)
    without, _ = _reconstructed(sources, pale, noise=0.7)
    assert _coverage(kept) > _coverage(without) + 0.05
    assert np.median(_errors(kept, truth)) < 0.01


def test_masked_pixels_get_no_depth() -> None:
    mask_u8 = np.full((300, 400), 255, np.uint8)
    mask_u8[:, 250:] = 0
    masked, without = (
        _reconstructed([camera([-0.4, 0, 0])], SLANTED, mask_u8=mask)[0].depth for mask in (mask_u8, None)
    )
    assert not masked[:, 250:].any()
    assert (masked[:, 60:245] > 0).mean() > 0.9
    assert (without[:, 250:] > 0).mean() > 0.5


def test_it_stops_when_told() -> None:
    def cancel() -> None:
        raise Cancelled

    view, truth = render(REFERENCE, [SLANTED])
    source, _ = render(camera([0.4, 0, 0]), [SLANTED])
    with pytest.raises(Cancelled):
        depth_and_normals(view, [source], sparse_points(REFERENCE, truth), check=cancel)


def test_points_of_another_shape_are_refused() -> None:
    view, _ = render(REFERENCE, [SLANTED])
    with pytest.raises(ValueError, match=r"points_world.shape=\(3, 4\), expected \(N, 3\)"):
        depth_and_normals(view, [], np.zeros((3, 4)))


def test_a_thin_pole_is_found_or_left_out_but_not_taken_for_the_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    """6 pixels wide, darker than the wall."""
    pole, wall = plane(3.0, 0, 0, (0.02, 5.0), seed=2), plane(5.0, 0.1, 0, (5.0, 5.0), seed=3)
    pole = replace(pole, texture_u8=(pole.texture_u8 * 0.4).astype(np.uint8))
    sources = [camera([x, y, 0]) for x, y in ((-0.3, 0), (0.3, 0), (0.2, 0.3), (-0.2, -0.3))]

    def shares() -> tuple[float, float]:
        result, truth = _reconstructed(sources, pole, wall)
        thin = truth < 3.5
        assert 5 < thin.sum() / 300 < 6.5
        at_pole, at_wall = (np.abs(result.depth[thin] / z - 1) < 0.03 for z in (3.0, 5.0))
        return float(at_pole.mean()), float(at_wall.mean())

    found, taken_for_wall = shares()
    assert found > 0.5, f"{found:.2f}"
    assert taken_for_wall < 0.1, f"{taken_for_wall:.2f}"
    monkeypatch.setattr(refine_module, "_MOST_LEVELS", 1e9)
    assert shares()[1] > taken_for_wall


def test_the_whole_range_is_searched_at_the_larger_size_by_the_pairs_whose_range_is_narrow() -> None:
    large = camera([0, 0, 0], size=(1600, 1200), focal=1680)
    sizes = sizes_coarse_to_fine(large.size, 400)
    points = np.random.default_rng(5).uniform([-1, -0.8, 2.0], [1, 0.8, 5.0], (300, 3))

    def first(*baselines: float) -> tuple[int, list[int]]:
        sources = [camera([x, 0, 0], size=(1600, 1200), focal=1680) for x in baselines]
        cameras = [[(large.camera_resized(s), source.camera_resized(s)) for s in sizes] for source in sources]
        return first_step(sizes, [[rectify(*pair, points) for pair in by_size] for by_size in cameras])

    assert sizes == [(400, 300), (800, 600), (1600, 1200)]
    # At 800 pixels 840 x baseline / depth, and a quarter more either way: 378 x baseline and 8.
    assert first(0.4, 0.5) == (1, [0, 1])
    assert first(0.4, 0.9, 0.5) == (1, [0, 2])
    assert first(0.4) == (1, [0])
    assert first(0.4, 0.9) == (0, [0, 1])
