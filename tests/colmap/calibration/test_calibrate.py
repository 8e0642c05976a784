"""Models calibrated whole, beside the cameras and places of the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import StopsWhen
from wall_survey import camera, given_cameras, position_error, survey, triangulation_of, write_database

from colmap_ihe.colmap.calibration import calibrate as module
from colmap_ihe.colmap.calibration.calibrate import Calibration, Known, calibrate, lenses_of
from colmap_ihe.colmap.calibration.choose import Chooser
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens
from colmap_ihe.colmap.calibration.rebuild import give
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.errors import Cancelled

OFF = camera(params=(1000, 612, 450, -0.05))
START = camera(params=(1020, 600, 450, 0), exif=True)


def mapped(truth: pycolmap.Reconstruction, folder: Path, *start: pycolmap.Camera) -> pycolmap.Reconstruction:
    """What COLMAP maps of a scene from these cameras on."""
    database = write_database(truth, folder / "database.db", {one.camera_id: one for one in start})
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=0, extract_colors=False)
    with quiet():
        return pycolmap.incremental_mapping(database, folder, folder, options)[0]


def known_of(*start: pycolmap.Camera, **more: Any) -> Known:
    return Known(cameras={one.camera_id: one for one in start}, **more)


def as_bytes(model: pycolmap.Reconstruction) -> list[bytes]:
    arrays = [camera.params for _, camera in sorted(model.cameras.items())]
    arrays += [model.images[i].cam_from_world().matrix() for i in sorted(model.reg_image_ids())]
    arrays += [point.xyz for _, point in sorted(model.points3D.items())]
    return [np.asarray(array).tobytes() for array in arrays]


def unchanged(model: pycolmap.Reconstruction, known: Known) -> bool:
    before = as_bytes(model)
    found = calibrate(model, known, triangulation_of(model))
    return found is None and as_bytes(model) == before


def test_a_principal_point_that_is_off_is_found_and_places_are_better(tmp_path: Path) -> None:
    truth = survey([OFF], points=700, noise=0.3, wrong=0.03)
    model = mapped(truth, tmp_path, START)
    before = position_error(model, truth)
    first = pycolmap.Reconstruction(model)
    found = calibrate(model, known_of(START), triangulation_of(truth))
    assert isinstance(found, Calibration)
    assert position_error(model, truth) < before / 2
    off = np.abs(np.subtract(model.cameras[1].params, OFF.params))
    assert (off < 4 * np.array(found.deviations[1].values)).all()
    assert found.freedoms == {1: Freedom("SIMPLE_RADIAL", 1, True)}
    assert found.gain.standard_errors > 5
    assert found.gain.chosen_px < found.gain.colmap_px
    assert model.num_points3D() >= 0.95 * first.num_points3D()
    again = pycolmap.Reconstruction(first)
    calibrate(again, known_of(START), triangulation_of(truth))
    assert as_bytes(again) == as_bytes(model)


def test_a_lens_that_colmap_shows_is_no_other_lens(tmp_path: Path) -> None:
    truth = survey([camera()], points=700, noise=0.3)
    model = mapped(truth, tmp_path, START)
    before = as_bytes(model)
    found = calibrate(model, known_of(START), triangulation_of(truth))
    assert isinstance(found, Calibration)
    assert not found.other_lens
    assert found.freedoms == {1: Freedom("SIMPLE_RADIAL", 1)}
    assert as_bytes(model) == before  # another adjustment of the same would be better or worse by chance
    deviations = found.deviations[1].values
    assert deviations[1:3] == (0, 0)
    assert abs(model.cameras[1].params[0] - 1000) < 3 * deviations[0] < 100


def test_a_fisheye_is_another_lens(tmp_path: Path) -> None:
    truth = survey(
        [camera("OPENCV_FISHEYE", (716, 716, 600, 450, 0.02, 0, 0, 0))], points=900, noise=0.3, reach=14
    )
    start = camera(params=(730, 600, 450, 0), exif=True)
    model = mapped(truth, tmp_path, start)
    found = calibrate(model, known_of(start), triangulation_of(truth))
    assert isinstance(found, Calibration)
    assert found.other_lens
    assert found.freedoms[1].model.endswith("FISHEYE")


def test_what_says_too_little_or_is_held_is_left_as_it_is() -> None:
    assert unchanged(survey([OFF], 2, noise=0.3), known_of(OFF))
    assert unchanged(survey([OFF], noise=0.3), known_of(OFF, held=frozenset({1})))
    assert unchanged(survey([OFF], points=60, noise=0.3), known_of(OFF))
    strangers = [camera(camera_id=i) for i in range(1, 9)]
    assert unchanged(survey(strangers, noise=0.3), known_of(*strangers))


def test_of_strangers_too_many_to_adjust_nothing_is_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_IMAGES", 4)
    strangers = [camera(camera_id=i) for i in range(1, 9)]
    assert unchanged(survey(strangers, noise=0.3), known_of(*strangers))


def test_a_camera_that_is_held_stays_to_the_bit_beside_one_that_is_not() -> None:
    held = camera(params=(1000.1, 601.3, 449.9, -0.0501), camera_id=2)
    truth = survey([OFF, held], 10, points=700, noise=0.3)
    model = pycolmap.Reconstruction(truth)
    given_cameras(model, [camera(params=(1003, 609, 450, -0.05))])
    found = calibrate(model, known_of(START, held, held=frozenset({2})), triangulation_of(truth))
    assert isinstance(found, Calibration)
    assert set(found.freedoms) == {1}
    assert model.cameras[2].params.tolist() == held.params.tolist()
    assert model.cameras[1].params == pytest.approx(OFF.params, abs=3)


def test_a_large_model_is_calibrated_by_some_of_its_images(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_IMAGES", 6)
    truth = survey([OFF], 10, points=700, noise=0.3)
    model = pycolmap.Reconstruction(truth)
    given_cameras(model, [camera(params=(1003, 608, 450, -0.05))])
    with quiet():
        found = calibrate(model, known_of(START), triangulation_of(truth))
    assert isinstance(found, Calibration)
    assert model.cameras[1].params == pytest.approx(OFF.params, abs=3)
    assert position_error(model, truth) < 0.005
    assert model.num_reg_images() == 10


def test_an_image_that_only_its_neighbour_sees_with_keeps_its_observations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "_TO_CHOOSE", 100)
    monkeypatch.setattr(module, "_POINTS_AN_IMAGE", 15)
    truth = survey([camera(params=(1000, 624, 450, -0.05))], points=1500, noise=0.2)
    for place, point in enumerate(truth.images[8].points2D):
        if not point.has_point3D():
            continue
        track = truth.points3D[point.point3D_id].track.elements
        if 1 not in {element.image_id for element in track}:
            truth.delete_observation(8, place)
            continue
        for element in track:
            if element.image_id not in (1, 8):
                truth.delete_observation(element.image_id, element.point2D_idx)
    before = truth.images[8].num_points3D
    assert before > 60
    model = pycolmap.Reconstruction(truth)
    given_cameras(model, [camera(params=(1000, 600, 450, -0.05))])
    with quiet():
        pycolmap.bundle_adjustment(model, pycolmap.BundleAdjustmentOptions(print_summary=False))
    calibrate(model, known_of(camera()), triangulation_of(truth))
    assert model.cameras[1].params[1] == pytest.approx(624, abs=3)
    assert model.images[8].num_points3D > 0.95 * before


def test_pictures_that_were_turned_share_a_lens_of_the_model_of_the_user() -> None:
    lenses = [OFF, camera(params=(1000, 450, 1200 - 612, -0.05), camera_id=2, size=(900, 1200))]
    start = [
        camera(params=(1010, 600, 450, 0)),
        camera(params=(1010, 450, 600, 0), camera_id=2, size=(900, 1200)),
    ]
    truth = survey(lenses, points=700, noise=0.3)
    for given_model in (False, True):
        model = pycolmap.Reconstruction(truth)
        given_cameras(model, start)
        known = known_of(*start, partners=[(1, 2)], given_model=given_model)
        found = calibrate(model, known, triangulation_of(truth))
        assert isinstance(found, Calibration)
        assert found.freedoms[1] == found.freedoms[2] == Freedom("SIMPLE_RADIAL", 1, True)
        for one in lenses:
            assert model.cameras[one.camera_id].params == pytest.approx(one.params, abs=3)


def test_lenses_are_free_that_took_enough() -> None:
    lenses = [camera(camera_id=i, size=(900, 1200) if i == 3 else (1200, 900)) for i in (1, 2, 3)]
    model = survey(lenses, 7)  # 3, 2 and 2 photographs
    free = Freedom("SIMPLE_RADIAL", 1)
    assert lenses_of(model, [1, 2, 3], Known()) == (
        Lens((0,), (0,), free),
        Lens((1,), (0,), None),
        Lens((2,), (0,), None),
    )
    together = Lens((1, 2), (0, 1), free)
    assert lenses_of(model, [1, 2, 3], Known(partners=[(2, 3)])) == (Lens((0,), (0,), free), together)
    held = Known(partners=[(2, 3)], held=frozenset({3}), starts={1: Freedom("RADIAL", 2, True)})
    assert lenses_of(model, [1, 2, 3], held) == (
        Lens((0,), (0,), Freedom("RADIAL", 2, True)),
        Lens((1, 2), (0, 1), None),
    )


def test_a_model_whose_points_are_all_wrong_is_left_as_it_is() -> None:
    model = survey([OFF], noise=0.3)
    for point in model.points3D.values():
        point.xyz = (0, 0, -40)
    assert unchanged(model, known_of(OFF))


def test_equations_without_a_solution_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr(Chooser, "climb", fail)
    model = survey([OFF], noise=0.3)
    cameras, poses = model.cameras[1].params.tolist(), model.images[1].cam_from_world().matrix()
    with pytest.raises(np.linalg.LinAlgError):
        calibrate(model, known_of(OFF), triangulation_of(model))
    assert model.cameras[1].params.tolist() == cameras
    assert (model.images[1].cam_from_world().matrix() == poses).all()


def test_equations_without_a_solution_the_second_time_leave_what_the_first_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = give

    def give_and_fail_from_now_on(*args: Any) -> None:
        given(*args)
        monkeypatch.setattr(Chooser, "again", fail)

    def fail(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(module, "_CHANGED", -1.0)  # a second time in any case
    monkeypatch.setattr(module, "give", give_and_fail_from_now_on)
    model = survey([OFF], points=700, noise=0.3)
    triangulation = triangulation_of(model)
    given_cameras(model, [camera(params=(1003, 608, 450, -0.05))])
    found = calibrate(model, known_of(START), triangulation)
    assert isinstance(found, Calibration)
    assert model.cameras[1].params == pytest.approx(OFF.params, abs=3)


def test_each_iteration_asks_whether_to_stop() -> None:
    asked: list[int] = []

    def never(done: int) -> bool:
        asked.append(done)
        return False

    def begun() -> pycolmap.Reconstruction:
        given_cameras(model := survey([OFF], noise=0.3), [START])
        return model

    model = begun()
    assert calibrate(model, known_of(START), triangulation_of(model), StopsWhen(never)) is not None
    asked_in_all, done = len(asked), asked[-1]
    assert asked_in_all > 20
    assert done == 3  # the lens, and a step before and after
    model = begun()
    with pytest.raises(Cancelled):
        calibrate(
            model, known_of(START), triangulation_of(model), StopsWhen(lambda done: done or never(done))
        )
    assert len(asked) > asked_in_all + 1
