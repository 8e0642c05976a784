"""Models of a mapping, calibrated, and mapped again where COLMAP could not show the lens and lost images by it."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wall_survey import camera, given_cameras, position_error, survey, write_database

from colmap_ihe.colmap.calibration import calibrate as calibrate_module
from colmap_ihe.colmap.calibration import models as module
from colmap_ihe.colmap.calibration.calibrate import Apart, Calibration, Known
from colmap_ihe.colmap.calibration.freedom import Freedom
from colmap_ihe.colmap.calibration.held_out import HeldOut
from colmap_ihe.colmap.calibration.models import Models, Setting, calibrate_models, known_of
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.errors import NativeError

FISHEYE = camera("OPENCV_FISHEYE", (716, 716, 600, 450, 0.02, 0, 0, 0))
START = camera(params=(730, 600, 450, 0), exif=True)
SETTINGS = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=0, extract_colors=False)
PLAIN = Calibration({1: Freedom("SIMPLE_RADIAL", 1)}, {}, HeldOut(1, 1, 0), False)
OTHER = Calibration({1: Freedom("SIMPLE_RADIAL", 1)}, {}, HeldOut(1, 0.5, 9), True)


def mapped(database: Path) -> Models:
    with quiet():
        return list(
            pycolmap.incremental_mapping(database, database.parent, database.parent, SETTINGS).values()
        )


def content(database: Path) -> list[str]:
    """All rows of a database; a counter in its file changes when it is only opened."""
    with closing(sqlite3.connect(database)) as opened:
        return list(opened.iterdump())


def never(_: Path) -> Models:
    raise AssertionError("nothing asks for this")


def run(
    models: Models,
    database: Path,
    map_again: Callable[[Path], Models],
    known: Known | None = None,
    problems: list[str] | None = None,
) -> tuple[Models, list[Calibration | None], list[list[str]]]:
    scratch = database.parent / "scratch"
    scratch.mkdir(exist_ok=True)
    told: list[str] = [] if problems is None else problems
    setting = Setting(database, known or Known(), SETTINGS, map_again, scratch, problems=told)
    with quiet():
        found = calibrate_models(models, setting)
    return found.models, found.calibrations, found.apart


@pytest.fixture
def fisheye(tmp_path: Path) -> tuple[pycolmap.Reconstruction, Path]:
    truth = survey([FISHEYE], points=900, noise=0.3, reach=14)
    return truth, write_database(truth, tmp_path / "database.db", {1: START})


def without_one(models: Models) -> Models:
    """The models, of which the first has lost an image."""
    models[0].deregister_frame(models[0].images[8].frame_id)
    return models


def test_another_lens_whose_images_are_in_place_is_calibrated_further_and_not_mapped_again(
    fisheye: tuple[pycolmap.Reconstruction, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, database = fisheye
    first, known = mapped(database), []  # type: tuple[Models, list[Known]]
    calibrate = calibrate_module.calibrate

    def noted(model: pycolmap.Reconstruction, given: Known, *rest: Any) -> Calibration | Apart | None:
        known.append(given)
        return calibrate(model, given, *rest)

    monkeypatch.setattr(module, "calibrate", noted)
    models, (calibration,), _ = run(first, database, never)
    assert models is first
    assert calibration is not None
    assert calibration.freedoms[1].model.endswith("FISHEYE")
    assert [one.starts[1].model.endswith("FISHEYE") if one.starts else None for one in known] == [None, True]
    assert (
        calibration.gain.chosen_px < calibration.gain.colmap_px / 2
    )  # against COLMAP's, not the first lens found
    assert position_error(models[0], truth) < 0.005


def test_a_mapping_begun_with_a_fisheye_counts_where_it_puts_all_in_place(
    fisheye: tuple[pycolmap.Reconstruction, Path],
) -> None:
    truth, database = fisheye
    asked: list[str] = []

    def map_again(copy: Path) -> Models:
        asked.append(copy.stem)
        return mapped(copy)

    models, _, _ = run(without_one(mapped(database)), database, map_again)
    assert asked == ["fisheyes"]
    assert position_error(models[0], truth) < 0.005


def test_an_image_that_was_misplaced_is_mapped_again(
    fisheye: tuple[pycolmap.Reconstruction, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, database = fisheye
    misplaced = pycolmap.Reconstruction(truth)
    image = misplaced.images[8]
    assert image.frame is not None
    aside = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0, 0.1, 0])), np.zeros(3)) * image.cam_from_world()
    image.frame.set_cam_from_world(1, aside)
    for first in (OTHER, PLAIN):  # also where COLMAP's model could have shown the lens
        outcomes(monkeypatch, first, PLAIN)
        assert run([misplaced], database, lambda _: [truth])[0] == [truth]
    outcomes(monkeypatch, OTHER, PLAIN)
    assert run([truth], database, never)[0] == [truth]


def test_a_further_calibration_that_fails_leaves_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models, database = two_models(tmp_path)
    outcomes(monkeypatch, OTHER, None)
    assert run(models[:1], database, never)[1] == [OTHER]


def test_another_lens_is_mapped_with_and_its_models_count(
    fisheye: tuple[pycolmap.Reconstruction, Path],
) -> None:
    truth, database = fisheye
    before, asked = content(database), []

    def map_again(copy: Path) -> Models:
        asked.append(copy)
        with pycolmap.Database.open(copy) as opened:
            lens = opened.read_camera(1)
        assert lens.model_name.endswith("FISHEYE")
        assert lens.has_prior_focal_length
        if len(asked) == 1:  # not of the lens that was found, where images are lost
            assert lens.params.tolist() == [730, 600, 450, 0, 0]
            return []
        assert lens.params[:3] == pytest.approx((716, 600, 450), abs=5)
        return mapped(copy)

    first = without_one(mapped(database))
    models, (calibration,), groups = run(first, database, map_again)
    assert [copy.parent.name for copy in asked] == ["scratch", "scratch"]
    assert models[0] is not first[0]
    assert models[0].num_reg_images() == 8
    assert calibration is not None
    assert calibration.freedoms[1].model.endswith("FISHEYE")
    assert position_error(models[0], truth) < 0.005
    assert groups == []
    assert content(database) == before


def test_models_of_fewer_images_do_not_count(fisheye: tuple[pycolmap.Reconstruction, Path]) -> None:
    truth, database = fisheye
    fewer = pycolmap.Reconstruction(truth)
    for number in (7, 8):
        fewer.deregister_frame(fewer.images[number].frame_id)
    for again in ([fewer], []):
        first = without_one(mapped(database))
        models, (calibration,), _ = run(first, database, lambda _, again=again: again)  # type: ignore[misc]
        assert models is first
        assert calibration is not None
        assert models[0].cameras[1].model_name.endswith("FISHEYE")


def test_where_mapping_again_fails_the_first_model_is_kept_and_it_is_told(
    fisheye: tuple[pycolmap.Reconstruction, Path],
) -> None:
    def fail(_: Path) -> Models:
        raise NativeError("RuntimeError: the mapper died")

    _, database = fisheye
    first, problems = without_one(mapped(database)), []  # type: tuple[Models, list[str]]
    models, (calibration,), _ = run(first, database, fail, problems=problems)
    assert models is first
    assert calibration is not None
    assert models[0].cameras[1].model_name.endswith("FISHEYE")
    assert len(problems) == 2
    for problem, cameras in zip(
        problems, ("the camera of a fisheye", "the lens that was found"), strict=True
    ):
        assert problem.startswith(f"mapping once more with {cameras} failed, and the first model is kept")
        assert "the mapper died" in problem


def test_equations_without_a_solution_leave_colmaps_model_and_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    models, database = two_models(tmp_path)
    monkeypatch.setattr(module, "calibrate", fail)
    problems: list[str] = []
    assert run(models, database, never, problems=problems) == (models, [None, None], [])
    assert len(problems) == 2
    assert problems[0].startswith("cameras are left as COLMAP has them")
    assert "Singular matrix" in problems[0]


def test_a_lens_that_colmap_shows_is_mapped_once(tmp_path: Path) -> None:
    truth = survey([camera()], points=700, noise=0.3)
    start = camera(params=(1020, 600, 450, 0), exif=True)
    database = write_database(truth, tmp_path / "database.db", {1: start})
    before = content(database)
    first = mapped(database)
    models, (calibration,), groups = run(first, database, never)
    assert models is first
    assert calibration is not None
    assert calibration.freedoms == {1: Freedom("SIMPLE_RADIAL", 1)}
    assert groups == []
    assert content(database) == before


def test_cameras_of_the_database_are_known_and_which_are_only_assumed(tmp_path: Path) -> None:
    lenses = [camera(params=(1000 + i, 600, 450, 0), camera_id=i, exif=i == 2) for i in (1, 2, 3)]
    database = write_database(survey(lenses, 6), tmp_path / "database.db")
    known = known_of(database, Known(held=frozenset({3}), check_shared=True))
    assert {i: one.params[0] for i, one in known.cameras.items()} == {1: 1001, 2: 1002, 3: 1003}
    assert known.assumed == {1}
    assert known_of(database, Known()).assumed == frozenset()


def test_poses_are_adjusted_with_as_many_threads_as_the_run_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[int] = []

    def adjusted(_model: object, _progress: object, threads: int) -> None:
        given.append(threads)

    monkeypatch.setattr(calibrate_module, "MOST_IMAGES", 6)
    monkeypatch.setattr(calibrate_module, "adjust_poses", adjusted)
    truth = survey([camera(params=(1000, 612, 447, -0.05))], 8, points=500, noise=0.3)
    given_cameras(truth, [START])
    run([truth], write_database(truth, tmp_path / "database.db"), lambda _: [])
    assert set(given) == {1}  # as SETTINGS says, which pipelines limit to those of a run


def test_where_little_is_mapped_wide_lenses_begin_as_fisheyes_and_others_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lenses = [
        camera(params=(730, 600, 450, 0.02)),
        camera(params=(2000, 600, 450, 0), camera_id=2, exif=True),
        camera("OPENCV", (730, 740, 610, 440, 0.01, 0, 0, 0), camera_id=3),  # of a calibration of the user's
        camera(params=(730, 600, 450, 0), camera_id=4),
    ]
    full = survey(lenses, 8, points=700)
    database, little = write_database(full, tmp_path / "database.db"), pycolmap.Reconstruction(full)
    for point_id in sorted(little.points3D)[len(little.points3D) // 8 :]:
        little.delete_point3D(point_id)
    starts: list[tuple[str, list[float]]] = []

    def map_again(copy: Path) -> Models:
        with pycolmap.Database.open(copy) as opened:
            starts.extend((one.model_name, one.params.tolist()) for one in opened.read_all_cameras())
        return [full]

    outcomes(monkeypatch, PLAIN, PLAIN)
    known = Known(held=frozenset({4}))
    models, found, _ = run([little], database, map_again, known)
    assert models == [full]
    assert found == [PLAIN]
    assert starts == [
        ("RADIAL_FISHEYE", [730, 600, 450, 0, 0]),
        ("SIMPLE_RADIAL", [2000, 600, 450, 0]),
        ("OPENCV", [730, 740, 610, 440, 0.01, 0, 0, 0]),
        ("SIMPLE_RADIAL", [730, 600, 450, 0]),
    ]
    assert run([little], database, lambda _: [little], known)[0] == [little]  # no more by it


def outcomes(monkeypatch: pytest.MonkeyPatch, *scripted: Calibration | Apart | None) -> list[Known]:
    """Let calibrations come out so, one after another; what they were given."""
    given: list[Known] = []
    left = list(scripted)

    def calibrate(_model: object, known: Known, *_: object) -> Calibration | Apart | None:
        given.append(known)
        return left.pop(0)

    monkeypatch.setattr(module, "calibrate", calibrate)
    return given


def two_models(folder: Path) -> tuple[Models, Path]:
    truth = survey([camera()], 6)
    return [truth, pycolmap.Reconstruction(truth)], write_database(truth, folder / "database.db")


def test_images_that_are_apart_are_mapped_with_cameras_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models, database = two_models(tmp_path)
    groups = [["01.jpg", "02.jpg", "03.jpg"], ["04.jpg", "05.jpg", "06.jpg"]]
    given = outcomes(monkeypatch, Apart(groups), PLAIN, PLAIN)
    cameras: list[int] = []

    def map_again(copy: Path) -> Models:
        with pycolmap.Database.open(copy) as opened:
            cameras.extend(image.camera_id for image in opened.read_all_images())
        return [pycolmap.Reconstruction(models[0])]

    again, found, told = run(models, database, map_again, Known(check_shared=True))
    assert len(set(cameras[:3])) == len(set(cameras[3:])) == 1
    assert cameras[0] != cameras[3]
    assert (len(again), found, told) == (1, [PLAIN], groups)
    assert [bool(known.assumed) for known in given] == [True, True, False]


def test_a_model_that_is_calibrated_is_not_calibrated_again_for_another_that_is_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models, database = two_models(tmp_path)
    given = outcomes(monkeypatch, PLAIN, Apart([["01.jpg"], ["02.jpg"]]), OTHER)
    again, found, told = run(models, database, never, Known(check_shared=True))
    assert again is models
    assert (found, told) == ([PLAIN, OTHER], [])
    assert [bool(known.assumed) for known in given] == [True, True, False]


def test_what_was_found_not_to_be_apart_is_not_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models, database = two_models(tmp_path)
    given = outcomes(monkeypatch, OTHER, PLAIN)
    models[0].deregister_frame(models[0].images[6].frame_id)
    again, found, _ = run(models[:1], database, lambda _: models[1:], Known(check_shared=True))
    assert (again, found) == (models[1:], [PLAIN])
    assert [bool(known.assumed) for known in given] == [True, False]
    assert given[1].starts == {}
