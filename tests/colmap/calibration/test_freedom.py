"""What is free of a lens, in what order richer freedoms come, and what is known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from wall_survey import camera

from colmap_ihe.colmap.calibration.freedom import CENTRE, FOCAL, Freedom, Lens, freed, plain
from colmap_ihe.colmap.native import pycolmap


def test_the_principal_point_and_one_and_two_steps_come_next() -> None:
    assert set(Freedom("SIMPLE_RADIAL", 1).richer()) == {
        Freedom("SIMPLE_RADIAL", 1, True),
        Freedom("RADIAL", 2),
        Freedom("RADIAL", 2, True),
        Freedom("OPENCV", 4, True),  # tangential coefficients only with a principal point
    }
    assert set(Freedom("RADIAL_FISHEYE", 2, True).richer()) == {
        Freedom("OPENCV_FISHEYE", 4, True),
        Freedom("OPENCV_FISHEYE", 4, True, True),
    }
    assert Freedom("FULL_OPENCV", 5, True, True).richer() == []
    assert Freedom("DIVISION", 1).richer() == [Freedom("DIVISION", 1, True)]


def test_steps_back_do_not_go_below_what_colmap_frees() -> None:
    simple, full = Freedom("SIMPLE_RADIAL", 1), Freedom("FULL_OPENCV", 5, True)
    assert full.poorer(simple) == [
        Freedom("SIMPLE_RADIAL", 1, True),
        Freedom("RADIAL", 2, True),
        Freedom("OPENCV", 4, True),
    ]
    assert full.poorer(Freedom("OPENCV", 4)) == [Freedom("OPENCV", 4, True)]
    assert simple.poorer(simple) == Freedom("FOV", 1).poorer(Freedom("FOV", 1)) == []


def test_the_other_kind_of_a_wide_lens() -> None:
    assert Freedom("OPENCV", 4, True).other_kind() == Freedom("RADIAL_FISHEYE", 2, True)
    assert Freedom("OPENCV_FISHEYE", 4).other_kind() == Freedom("RADIAL", 2, True)
    assert Freedom("FOV", 1).other_kind() is None


def test_what_is_small_by_nature_counts_as_one_parameter() -> None:
    assert [Freedom("RADIAL", 2, centre).price for centre in (False, True)] == [3, 4]
    assert Freedom("OPENCV", 4, True).price == 5
    assert Freedom("OPENCV", 4, True, True).price == 15


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "FOV"])
def test_what_comes_next_is_a_part_of_the_richest(model: str) -> None:
    waiting = [plain(pycolmap.Camera.create_from_model_name(1, model, 900, 1200, 900))]
    seen: set[Freedom] = set()
    while waiting:
        freedom = waiting.pop()
        if freedom in seen:
            continue
        seen.add(freedom)
        rich = freedom.richest()
        columns = freedom.columns_in(rich)
        assert len(columns) == len(set(columns)) == freedom.count
        assert max(columns) < rich.count
        waiting.extend(freedom.richer())
    assert any(freedom.centre for freedom in seen)


@pytest.mark.parametrize(
    "model",
    [m for m in pycolmap.CameraModelId.__members__ if m not in ("INVALID", "EQUIRECTANGULAR")],
)
def test_every_model_of_colmap_can_be_free(model: str) -> None:
    lens = pycolmap.Camera.create_from_model_name(1, model, 900, 1200, 900)
    freedom = plain(lens)
    (free,), prior = freed([Lens((0,), (0,), Freedom(model, freedom.coefficients, True))], [lens], [lens])
    assert free.basis.shape == (len(lens.params), freedom.count + 2)
    assert free.at(np.zeros(freedom.count + 2)).params.tolist() == lens.params.tolist()
    assert (prior.deviation > 0).all()


def test_what_is_known_beforehand() -> None:
    lens = camera("OPENCV", (1010, 990, 612, 440, 0.1, 0.2, 0.002, 0.001))
    known = camera(params=(1050, 600, 450, 0), exif=True)
    _, prior = freed([Lens((0,), (0,), Freedom("OPENCV", 4, True, True))], [lens], [known])
    # From (1010, 990) on: EXIF says 1050 for both, no coefficients, the middle, and square pixels.
    assert prior.mean == pytest.approx([50, -0.1, -0.2, -0.002, -0.001, -12, 10, -10])
    assert prior.deviation[0] == FOCAL * 1050
    assert prior.deviation[5:7].tolist() == [CENTRE * 1200] * 2
    _, unknown = freed([Lens((0,), (0,), plain(lens))], [lens], [camera()])
    assert (unknown.mean[0], unknown.deviation[0]) == (0, np.inf)


def test_two_focal_lengths_move_together_and_apart() -> None:
    lens = camera("OPENCV", (1000, 1000, 600, 450, 0, 0, 0, 0))
    portrait = camera("OPENCV", (1, 1, 1, 1, 0, 0, 0, 0), camera_id=2, size=(900, 1200))
    both = Lens((0, 1), (0, 1), Freedom("OPENCV", 4, True, True))
    (first, second), _ = freed([both], [lens, portrait], [lens, portrait])
    change = np.array([5, 0, 0, 0, 0, 0, 0, 2.0])
    assert first.at(change).params[:2].tolist() == [1007, 1003]
    assert second.at(change).params[:2].tolist() == [1003, 1007]


def test_lenses_have_parameters_of_their_own() -> None:
    lenses = [Lens((1,), (0,), Freedom("SIMPLE_RADIAL", 1)), Lens((0,), (0,), Freedom("RADIAL", 2, True))]
    cameras = [camera(), camera(params=(1100, 600, 450, 0), camera_id=2)]
    free, prior = freed(lenses, cameras, cameras)
    assert len(prior.mean) == 7
    values = np.array([10, 0.1, 20, 0.2, 0.3, 4, 5])
    assert free[1].at(values).params.tolist() == [1110, 600, 450, 0.1]
    assert free[0].at(values).params == pytest.approx([1020, 604, 455, 0.15, 0.3], abs=1e-3)


def test_cameras_that_are_not_free_stay_as_they_are_to_the_bit() -> None:
    odd = (1000.1, 7.3, 1449.7, -0.0501)  # a principal point for which x - w / 2 + w / 2 is another number
    cameras = [camera(params=odd), camera(params=(900.7, 3.1, 999.9, 0.1), camera_id=2, size=(900, 1200))]
    cameras.append(camera(camera_id=3))
    lenses = [Lens((0, 1), (0, 1), None), Lens((2,), (0,), Freedom("SIMPLE_RADIAL", 1))]
    free, prior = freed(lenses, cameras, cameras)
    assert len(prior.mean) == 2
    for one, lens in zip(free[:2], cameras[:2], strict=True):
        held = one.at(np.array([7.0, 0.3]))
        assert held.params.tolist() == lens.params.tolist()
        assert (held.width, held.height, held.camera_id) == (lens.width, lens.height, lens.camera_id)
