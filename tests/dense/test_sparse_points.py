"""Which images see which points: against the tracks of the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from doubled import doubled_model
from plane import make_project
from running import StopsWhen

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.sparse_points import sparse_points
from colmap_ihe.errors import Cancelled


def pairs_of_tracks(model: pycolmap.Reconstruction, reference: int) -> set[tuple[tuple[float, ...], int]]:
    """Points, by their coordinates, and images of those that the reference sees."""
    found = set()
    for point in model.points3D.values():
        images = {element.image_id for element in point.track.elements}
        if reference in images:
            found |= {(tuple(point.xyz), image) for image in images}
    return found


def test_each_pair_of_a_point_and_an_image_is_there_once(tmp_path: Path) -> None:
    make_project(tmp_path)
    plane = pycolmap.Reconstruction(tmp_path / "sparse")
    for model in (plane, doubled_model([1, 2, 3], [1, 1, 2, 2], [2, 4, 4], [3, 4])):
        points = sparse_points(model)
        for reference in model.reg_image_ids():
            xyz, rows, images = points.seen_from(reference)
            assert len(np.unique(xyz, axis=0)) == len(xyz)
            pairs = [(tuple(xyz[row]), image) for row, image in zip(rows, images.tolist(), strict=True)]
            assert len(pairs) == len(set(pairs))
            assert set(pairs) == pairs_of_tracks(model, reference)


def test_an_image_without_points_sees_none() -> None:
    xyz, rows, images = sparse_points(doubled_model([1, 2], images=3)).seen_from(3)
    assert xyz.shape == (0, 3) and len(rows) == len(images) == 0


def test_it_stops_when_asked_to() -> None:
    with pytest.raises(Cancelled):
        sparse_points(doubled_model([1, 2]), StopsWhen(lambda _: True))
