"""What the photographs of a model see of it, as arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.observations import observations_of, points_of_two

Made = tuple[pycolmap.Reconstruction, Path]


@pytest.fixture
def made(tmp_path: Path) -> Made:
    """A model of ten photographs without noise, and its database."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions(num_frames_per_rig=5, num_points3D=40)
    with pycolmap.Database.open(tmp_path / "database.db") as database:
        return pycolmap.synthesize_dataset(options, database), tmp_path / "database.db"


def test_errors_are_those_of_the_pixels_and_depths_lie_along_the_axis(made: Made) -> None:
    model, _ = made
    name = sorted(image.name for image in model.images.values())[0]
    image = model.find_image_with_name(name)
    first = image.get_observation_points2D()[0]
    number = next(n for n, p in enumerate(image.points2D) if p.point3D_id == first.point3D_id)
    image.points2D[number].xy = first.xy + np.array((3.0, 4.0))
    seen = observations_of(model)
    assert seen.names[0] == name and seen.focal_px == pytest.approx(np.full(10, 1280.0))
    moved = seen.errors_px > 0.01
    assert moved.sum() == 1 and seen.errors_px[moved] == pytest.approx([5.0], abs=1e-6)
    one = np.flatnonzero(moved)[0]
    there = image.cam_from_world() * model.points3D[first.point3D_id].xyz
    assert seen.depths[one] == pytest.approx(there[2])
    assert seen.centres[0] == pytest.approx(image.projection_center())


def test_matches_of_two_that_are_no_points_are_found_where_they_were(made: Made) -> None:
    model, database = made
    points, _ = points_of_two(model, database, observations_of(model))
    assert len(points) == 0  # all matches are points
    lost = sorted(model.points3D)[:3]
    places = {i: model.points3D[i].xyz.copy() for i in lost}
    pairs = sum(n * (n - 1) // 2 for n in (len(model.points3D[i].track.elements) for i in lost))
    for i in lost:
        model.delete_point3D(i)
    points, images = points_of_two(model, database, observations_of(model))
    assert len(points) == len(images) == pairs
    near = np.linalg.norm(points[:, None] - np.array(list(places.values())), axis=2).min(axis=1)
    assert near.max() < 1e-3 and (images[:, 0] != images[:, 1]).all()
