"""The stage that brings a model into metres, on the small demo with control of its truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.colmap.measures import poses_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.evaluation.truth import key_of, read_truth
from colmap_ihe.photographs.exif.xmp import RtkPosition
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.options import Options

MakeOptions = Callable[..., Options]
OFF = ("dense.enabled=false", "mesh.enabled=false")


def positions_of(small_demo: Path, names: list[str]) -> str:
    """Return a table of where the demo's cameras stood, in a map's coordinates, of Munich."""
    truth = read_truth(small_demo / "truth")
    rows = ["image,x,y,z,accuracy_m"]
    for name in names:
        pose = truth.images[key_of(name)].cam_from_world
        x, y, z = (-pose[:, :3].T @ pose[:, 3]) + (691_000.0, 5_334_000.0, 515.0)
        rows.append(f"{name},{x:.4f},{y:.4f},{z:.4f},0.01")
    return "\n".join(rows)


def test_a_project_becomes_metric_and_is_so_no_more_without_its_control(
    finished: Path, small_demo: Path, quick_options: MakeOptions
) -> None:
    names = sorted(file.name for file in (finished / "images").iterdir())
    done = reconstruct(finished, quick_options(*OFF), until="survey")
    assert (done.summary["metric"], done.sparse_model.name) == (False, "0")
    assert not (finished / "report/georeference.json").exists()
    (finished / "control").mkdir()
    (finished / "control/positions.csv").write_text(positions_of(small_demo, names))
    options = quick_options(*OFF, "survey.crs=EPSG:25832")
    done = reconstruct(finished, options, until="survey")
    assert done.stages_run == ("survey",)
    assert (done.summary["metric"], done.summary["crs"]) == (True, "EPSG:25832")
    assert done.summary["position_rms_m"] < 0.05
    assert done.sparse_model == finished / "workspace/metric"
    written = json.loads((finished / "report/georeference.json").read_text())
    assert (written["method"], written["offset"]) == ("positions", [691_000, 5_334_000, 0])
    assert "Survey</h2>" in (finished / "report/index.html").read_text()
    truth = read_truth(small_demo / "truth")
    for name, pose in poses_of(done.sparse_model).items():
        true = truth.images[key_of(name)].cam_from_world
        apart = (-pose[:, :3].T @ pose[:, 3]) - (-true[:, :3].T @ true[:, 3]) - (0, 0, 515)
        assert np.linalg.norm(apart) < 0.05
    assert reconstruct(finished, options, until="survey").stages_run == ()
    (finished / "control/positions.csv").unlink()
    done = reconstruct(finished, options, until="survey")
    assert (done.stages_run, done.summary["metric"]) == (("survey",), False)
    assert not (finished / "workspace/metric").exists()


def test_fixed_rtk_of_a_drone_is_a_position(
    finished: Path, small_demo: Path, quick_options: MakeOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = read_truth(small_demo / "truth")

    def rtk(photograph: Path) -> RtkPosition:
        pose = truth.images[key_of(photograph.name)].cam_from_world
        centre = -pose[:, :3].T @ pose[:, 3]
        latitude, longitude, height = (
            pycolmap.GPSTransform().enu_to_ellipsoid(centre[None], 48.0, 11.0, 500.0)[0].tolist()
        )
        return RtkPosition(longitude, latitude, height, 0.02)

    monkeypatch.setattr("colmap_ihe.pipeline.stages.survey.rtk_position", rtk)
    done = reconstruct(finished, quick_options(*OFF), start="survey", until="survey")
    assert (done.summary["metric_by"], done.summary["crs"]) == ("positions", "EPSG:4979")
    assert done.summary["position_rms_m"] < 0.05


def test_with_align_none_nothing_is_read(finished: Path, quick_options: MakeOptions) -> None:
    (finished / "control").mkdir()
    (finished / "control/points.csv").write_text("nonsense")
    done = reconstruct(finished, quick_options(*OFF, "survey.align=none"), until="survey")
    assert done.summary["metric"] is False


def test_the_model_of_the_mapper_stays(finished: Path, small_demo: Path, quick_options: MakeOptions) -> None:
    before = pycolmap.Reconstruction(finished / "workspace/sparse/0").images[1].cam_from_world().matrix()
    names = sorted(file.name for file in (finished / "images").iterdir())
    (finished / "control").mkdir()
    (finished / "control/positions.csv").write_text(positions_of(small_demo, names))
    reconstruct(finished, quick_options(*OFF), until="survey")
    after = pycolmap.Reconstruction(finished / "workspace/sparse/0").images[1].cam_from_world().matrix()
    np.testing.assert_array_equal(before, after)
    states = {s.name: s.state for s in status(finished, quick_options(*OFF))}
    assert (states["sparse"], states["survey"]) == ("done", "done")
