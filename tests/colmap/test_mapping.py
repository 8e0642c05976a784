"""Mappers: how they are stopped, what they refuse, and cameras that they hold."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from running import StopsWhen

from colmap_ihe.colmap import mapping
from colmap_ihe.colmap.calibration.calibrate import Known
from colmap_ihe.colmap.mapper_options import native_options
from colmap_ihe.colmap.mapping import MappingInput, map_images, map_in_process
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.errors import Cancelled, OptionError
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.project.options import SparseOptions


def sleep(_given: MappingInput, _progress: Progress) -> None:
    time.sleep(60)


def given(project: Path, **values: object) -> MappingInput:
    options = SparseOptions(mapper="hierarchical", colmap=values)
    return MappingInput(project / "database.db", project / "images", project / "out", options, 8)


def test_stopped_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping, "_map", sleep)
    began = time.monotonic()
    with pytest.raises(Cancelled):
        map_in_process(given(tmp_path), StopsWhen(lambda _: time.monotonic() > began + 0.3))
    assert time.monotonic() - began < 10


def test_the_hierarchical_mapper_takes_the_options_of_the_incremental_one(tmp_path: Path) -> None:
    values: dict[str, object] = {"num_workers": 3, "ba_refine_focal_length": False, "min_num_matches": 11}
    values["incremental_options"] = {"min_num_matches": 12, "min_model_size": 4}
    settings = native_options(given(tmp_path, **values).options)
    assert settings.num_workers == 3
    parts = settings.incremental_options
    assert (parts.ba_refine_focal_length, parts.min_num_matches, parts.min_model_size) == (False, 12, 4)
    assert parts.ba_refine_extra_params
    for wrong in (
        {"no_such_option": 1},
        {"ba_refine_focal_length": "perhaps"},
        {"ba_refine_focal_length": False, "incremental_options": 5},
    ):
        with pytest.raises(OptionError, match=r"sparse\.colmap"):
            native_options(given(tmp_path, **wrong).options)


def test_adjustments_end_when_little_changes_unless_told_otherwise(tmp_path: Path) -> None:
    parts = native_options(given(tmp_path, ba_global_function_tolerance=0.0).options).incremental_options
    assert (parts.ba_local_function_tolerance, parts.ba_global_function_tolerance) == (1e-3, 0.0)
    incremental = native_options(SparseOptions(colmap={"ba_local_function_tolerance": 1e-9}))
    assert incremental.ba_local_function_tolerance == 1e-9
    assert incremental.ba_global_function_tolerance == 1e-4


PARAMS = (1292.8, 1295.36, 512.0, 384.0, 0.02, -0.007, 0.001, 0.0005)
"""As cameras start: about 1 % from the truth."""


def synthetic(folder: Path) -> Path:
    """Write a database of twelve images by two cameras, each of which starts from `PARAMS`; return its path."""
    made = pycolmap.SyntheticDatasetOptions(
        num_rigs=2, num_cameras_per_rig=1, num_frames_per_rig=6, num_points3D=150,
        camera_model_id=pycolmap.CameraModelId.OPENCV,
        camera_params=[1280, 1280, 512, 384, 0.02, -0.01, 0.001, 0.0005],
    )  # fmt: skip
    pycolmap.set_random_seed(1)
    with quiet(), pycolmap.Database.open(folder / "database.db") as database:
        model = pycolmap.synthesize_dataset(made, database)
        pycolmap.synthesize_noise(pycolmap.SyntheticNoiseOptions(point2D_stddev=0.1), model, database)
        for camera in database.read_all_cameras():
            camera.params, camera.has_prior_focal_length = list(PARAMS), True
            database.update_camera(camera)
    return folder / "database.db"


def params_of(sparse: Path) -> dict[int, list[float]]:
    cameras = pycolmap.Reconstruction(sparse / "0").cameras.values()
    return {camera.camera_id: camera.params.tolist() for camera in cameras}


def test_cameras_that_are_held_come_out_to_the_bit(tmp_path: Path) -> None:
    database = synthetic(tmp_path)
    both: frozenset[int] = frozenset({1, 2})
    for mapper in ("incremental", "hierarchical", "global"):
        options = SparseOptions.model_validate({"mapper": mapper})
        known = Known(held=both)
        (model,) = map_images(database, tmp_path, tmp_path / mapper, options, 12, SILENT, known=known).models
        assert model.registered_images == 12
        assert params_of(tmp_path / mapper) == {1: list(PARAMS), 2: list(PARAMS)}
    refined = map_images(database, tmp_path, tmp_path / "refined", SparseOptions(), 12, SILENT).models
    assert refined[0].mean_reprojection_error_px < model.mean_reprojection_error_px
    for params in params_of(tmp_path / "refined").values():
        np.testing.assert_allclose(params[:2], 1280, rtol=5e-3)


def test_one_camera_is_held_and_the_other_refined(tmp_path: Path) -> None:
    database = synthetic(tmp_path)
    refine = {"ba_refine_focal_length": True, "mapper": {"abs_pose_refine_focal_length": True}}
    for mapper, options in (("incremental", {}), ("incremental", refine), ("hierarchical", {})):
        sparse = SparseOptions.model_validate({"mapper": mapper, "colmap": options})
        map_images(
            database, tmp_path, tmp_path / "sparse", sparse, 12, SILENT, known=Known(held=frozenset({1}))
        )
        found = params_of(tmp_path / "sparse")
        assert found[1] == list(PARAMS)
        np.testing.assert_allclose(found[2][:2], 1280, rtol=5e-3)
    with pytest.raises(OptionError, match=r"holds all cameras or none; camera\.fixed would hold 1 of 2"):
        map_images(
            database,
            tmp_path,
            tmp_path / "other",
            SparseOptions(mapper="global"),
            12,
            SILENT,
            known=Known(held=frozenset({1})),
        )
    assert not list(tmp_path.glob("*other*"))
