"""What is chosen of a lens is what the scene was photographed with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from wall_survey import camera, given_cameras, moved_a_little, pixels_of, survey, whole_block

from colmap_ihe.colmap.calibration.choose import Chooser, Fit, simplest
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens
from colmap_ihe.colmap.native import pycolmap

SIMPLE = Freedom("SIMPLE_RADIAL", 1)
SCENE: dict[str, Any] = {"points": 700, "noise": 0.3, "wrong": 0.03}


def begun(
    truth: Sequence[pycolmap.Camera],
    start: Sequence[pycolmap.Camera],
    lenses: tuple[Lens, ...],
    **of_scene: Any,
) -> tuple[Chooser, Fit]:
    """A chooser for a scene, and its fit with the lenses as free as they are."""
    model = survey(truth, **(SCENE | of_scene))
    moved_a_little(model, 1e-3)
    given_cameras(model, start)
    block, cameras = whole_block(model)
    chooser = Chooser(block, list(start))
    return chooser, chooser.again(chooser.fit(block, lenses, cameras))


def chosen(truth: pycolmap.Camera, start: pycolmap.Camera, **of_scene: Any) -> tuple[Freedom, Fit]:
    chooser, fit = begun([truth], [start], (Lens((0,), (0,), SIMPLE),), **of_scene)
    best = chooser.chosen(fit, 0)
    assert best.lenses[0].freedom is not None
    return best.lenses[0].freedom, best


START = camera(params=(1020, 600, 450, 0), exif=True)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_lens_in_the_middle_stays_simple(seed: int) -> None:
    freedom, fit = chosen(camera(), START, seed=seed)
    assert freedom == SIMPLE
    assert fit.cameras[0].params == pytest.approx((1000, 600, 450, -0.05), rel=0.1)
    assert fit.cameras[0].params[1:3].tolist() == [600, 450]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_principal_point_that_is_off_is_found(seed: int) -> None:
    freedom, fit = chosen(camera(params=(1000, 612, 447, -0.05)), START, seed=seed)
    assert freedom == Freedom("SIMPLE_RADIAL", 1, True)
    assert fit.cameras[0].params[:3] == pytest.approx((1000, 612, 447), abs=3)


def test_a_second_coefficient_is_free_where_it_matters() -> None:
    truth = camera("RADIAL", (1000, 600, 450, -0.15, 0.08))
    freedom, fit = chosen(truth, START)
    assert freedom == Freedom("RADIAL", 2)
    assert fit.cameras[0].params[3:] == pytest.approx((-0.15, 0.08), abs=0.01)


def test_tangential_coefficients_are_found() -> None:
    truth = camera("OPENCV", (1000, 1000, 609, 444, -0.1, 0.02, 0.002, -0.002))
    freedom, fit = chosen(truth, START, points=1500)
    assert freedom == Freedom("OPENCV", 4, True)
    assert fit.cameras[0].params[6:] == pytest.approx((0.002, -0.002), abs=5e-4)


def test_a_fisheye_is_told_from_a_perspective_lens() -> None:
    diagonal_120 = float(np.hypot(1200, 900) / np.radians(120))
    truth = camera("OPENCV_FISHEYE", (diagonal_120, diagonal_120, 600, 450, 0.02, -0.01, 0, 0))
    start = camera(params=(diagonal_120, 600, 450, -0.1))
    freedom, fit = chosen(truth, start, points=1500, reach=14)
    assert freedom.model.endswith("FISHEYE")
    rays = np.column_stack([np.tan(np.radians([0, 20, 40, 50])), np.zeros(4), np.ones(4)])
    np.testing.assert_allclose(pixels_of(fit.cameras[0], rays), pixels_of(truth, rays), atol=1.0)


@pytest.mark.parametrize("seed", [1, 3])
def test_a_wide_lens_that_is_no_fisheye_stays_perspective(seed: int) -> None:
    truth = camera(params=(700, 600, 450, -0.05))
    freedom, _ = chosen(truth, camera(params=(710, 600, 450, 0)), points=1200, reach=12, seed=seed)
    assert freedom == SIMPLE  # though a fisheye shows it as well, and by chance a little better


def test_what_was_freed_and_comes_out_as_nothing_is_held_again() -> None:
    truth = camera(params=(1000, 612, 447, -0.05))
    chooser, fit = begun([truth], [START], (Lens((0,), (0,), Freedom("OPENCV", 4, True)),))
    best = chooser.climb(fit, 0)
    assert best.lenses[0].freedom == Freedom("SIMPLE_RADIAL", 1, True)
    assert best.cameras[0].params == pytest.approx(truth.params, abs=3)


def test_the_model_of_the_user_is_kept() -> None:
    truth = camera("RADIAL", (1000, 612, 447, -0.15, 0.08))
    chooser, fit = begun([truth], [START], (Lens((0,), (0,), SIMPLE),))
    best = chooser.climb(fit, 0, steps=False)
    assert best.lenses[0].freedom == Freedom("SIMPLE_RADIAL", 1, True)
    full = pycolmap.Camera.create_from_model_name(1, "FULL_OPENCV", 1020, 1200, 900)
    chooser, fit = begun([truth], [full], (Lens((0,), (0,), Freedom("FULL_OPENCV", 8)),))
    best = chooser.climb(fit, 0, steps=False)
    assert best.lenses[0].freedom == Freedom("FULL_OPENCV", 8, True)


def test_of_two_lenses_each_is_chosen_by_itself_and_a_third_is_held() -> None:
    truth = [
        camera("RADIAL", (1100, 600, 450, -0.15, 0.08)),
        camera(params=(1000, 612, 447, -0.05), camera_id=2),
        camera(params=(900.1, 601.7, 449.3, 0.01), camera_id=3),
    ]
    start = [camera(params=(1100, 600, 450, -0.1)), camera(params=(1020, 600, 450, 0), camera_id=2), truth[2]]
    lenses = (Lens((0,), (0,), SIMPLE), Lens((1,), (0,), SIMPLE), Lens((2,), (0,), None))
    chooser, fit = begun(truth, start, lenses, count=9, points=900)
    best = fit
    for number in range(3):
        best = chooser.chosen(chooser.turned(best, number), number)
    assert [lens.freedom for lens in best.lenses] == [
        Freedom("RADIAL", 2),
        Freedom("SIMPLE_RADIAL", 1, True),
        None,
    ]
    assert best.cameras[2].params.tolist() == truth[2].params.tolist()


def landscape_and_portrait(quarter: int, focal: float = 1000) -> list[pycolmap.Camera]:
    """One lens, whose second pictures were turned clockwise by so many quarters, by hand."""
    x, y = 612.0, 443.0
    centre = {1: (900 - y, x), 3: (y, 1200 - x)}[quarter]
    second = camera(params=(focal, *centre, -0.05), camera_id=2, size=(900, 1200))
    return [camera(params=(1000, x, y, -0.05)), second]


PAIR = (Lens((0, 1), (0, 1), SIMPLE),)
MIDDLES = [
    camera(params=(1010, 600, 450, 0)),
    camera(params=(1010, 450, 600, 0), camera_id=2, size=(900, 1200)),
]


@pytest.mark.parametrize("quarter", [1, 3])
def test_pictures_that_were_turned_share_a_lens(quarter: int) -> None:
    truth = landscape_and_portrait(quarter)
    chooser, fit = begun(truth, MIDDLES, PAIR)
    best = chooser.climb(chooser.turned(fit, 0), 0)
    assert best.lenses == (Lens((0, 1), (0, quarter), Freedom("SIMPLE_RADIAL", 1, True)),)
    first, second = (one.params for one in best.cameras)
    assert (first[0], first[3]) == (second[0], second[3])
    for found, true in zip(best.cameras, truth, strict=True):
        assert found.params == pytest.approx(true.params, abs=3)


def test_two_lenses_stay_two() -> None:
    truth = landscape_and_portrait(1, focal=1080)
    start = [MIDDLES[0], camera(params=(1080, 450, 600, 0), camera_id=2, size=(900, 1200))]
    chooser, fit = begun(truth, start, PAIR)
    best = chooser.turned(fit, 0)
    assert [lens.cameras for lens in best.lenses] == [(0,), (1,)]
    for number in (0, 1):
        best = chooser.climb(best, number)
    for found, true in zip(best.cameras, truth, strict=True):
        assert found.params == pytest.approx(true.params, abs=4)


def test_of_fits_that_are_about_as_good_the_simplest_counts() -> None:
    assert simplest([100.0, 90, 80], [2, 4, 6]) == 0  # 6 a parameter are no gain
    assert simplest([100.0, 70, 60], [2, 4, 6]) == 1
    assert simplest([100.0, 70, 40], [2, 4, 6]) == 2
    assert simplest([100.0, 99, 98], [3, 3, 3]) == 2
