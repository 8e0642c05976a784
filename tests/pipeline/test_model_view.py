"""A sparse model as a page shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from doubled import doubled_model

from colmap_ihe.colmap.mapping import _colour_points
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.undistort import read_colour
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.model_view import ModelView


def test_points_are_counted_by_photographs_and_never_by_more_than_there_are(tmp_path: Path) -> None:
    doubled_model([1, 2, 3, 4], [1, 1, 2, 2, 3, 4], [1, 1, 2]).write(tmp_path)
    view = ModelView(tmp_path)
    assert view.points_by_images() == {2: 1, 4: 2}
    assert [view.seen(name).points for name in view.names] == [3, 3, 2, 2]


def test_the_points_of_the_model_have_the_colours_of_the_twins(finished: Path) -> None:
    for folder in ("workspace/sparse/0", "workspace/dense/0/sparse", "workspace/dense/0/sparse/0"):
        model = pycolmap.Reconstruction(finished / folder)
        colours = np.array([point.color for point in model.points3D.values()], int)
        assert (np.ptp(colours, axis=1) > 0).mean() > 0.9, folder
    model = pycolmap.Reconstruction(finished / "workspace/sparse/0")
    twins = {
        i: read_colour(finished / "colour" / model.images[i].name).astype(int) for i in model.reg_image_ids()
    }
    away = []
    for point in model.points3D.values():
        seen = [
            (e.image_id, model.images[e.image_id].points2D[e.point2D_idx].xy) for e in point.track.elements
        ]
        there = [twins[image_id][int(y), int(x)] for image_id, (x, y) in seen]
        away.append(np.abs(np.mean(there, axis=0) - point.color).max())
    assert np.median(away) < 4


def test_a_missing_colour_twin_is_named(finished: Path) -> None:
    model = pycolmap.Reconstruction(finished / "workspace/sparse/0")
    name = model.images[min(model.reg_image_ids())].name
    (finished / "colour" / name).unlink()
    with pytest.raises(ProjectError, match=f"{name}: no such colour twin"):
        _colour_points([model], finished / "colour", SILENT)
