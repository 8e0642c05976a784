"""A sparse model as a page shows it."""

from __future__ import annotations

from pathlib import Path

import lenses
import numpy as np
import pytest
from doubled import doubled_model
from lenses import POSES, SIZE, Lens, fisheye

from colmap_ihe.colmap.mapping import _colour_points
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.ply import write_rows
from colmap_ihe.dense.undistort import read_colour
from colmap_ihe.errors import ProjectError
from colmap_ihe.evaluation.truth import align_similarity
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.model_view import ModelView, cloud_as_seen


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


def test_corners_of_a_picture_are_on_the_rays_of_its_pixels(tmp_path: Path) -> None:
    """Of a lens off the middle, with distortion, of a fisheye, and of one that is too wide for a flat picture."""
    chosen = [
        Lens("OPENCV", (330, 333), (-0.12, 0.03, 0.002, -0.001)),
        Lens("PINHOLE", (330, 400)),
        fisheye(120, "RADIAL_FISHEYE", (-0.02, 0.004)),
        fisheye(210),
    ]
    lens = dict(zip(POSES, chosen, strict=True))
    lenses.model_of(lens).write(tmp_path)
    view = ModelView(tmp_path)
    cameras = {name: view.camera(name) for name in POSES}
    shown = align_similarity(
        np.array([POSES[name].centre for name in POSES]), np.array([cameras[name].centre for name in POSES])
    )
    width, height = SIZE
    for name, camera in cameras.items():
        centre, corners, box = camera.centre, camera.corners, camera.box
        directions = (corners - centre).astype(float) @ shown.rotation @ POSES[name].rotation.T
        rays = directions / directions[:, 2:]
        pixels = np.array([(0, 0), (width, 0), (width, height), (0, height)], float)
        if lens[name] == chosen[-1]:
            assert np.degrees(np.arctan(np.linalg.norm(rays[:, :2], axis=1))).max() == pytest.approx(
                79, abs=1.1
            )
            assert 0 < box[0] < box[2] < 1 and 0 < box[1] < box[3] < 1  # its middle alone is shown
            continue
        assert box == pytest.approx([0, 0, 1, 1])
        assert rays == pytest.approx(lens[name].rays(pixels), abs=2e-4), name
        across, down = corners[1] - corners[0], corners[3] - corners[0]
        middle = corners[0] + camera.grid[4, 4] @ np.array([across, down]) - centre
        ray = middle.astype(float) @ shown.rotation @ POSES[name].rotation.T
        assert ray / ray[2] == pytest.approx(lens[name].rays(pixels[2:3] / 2)[0], abs=2e-4), name
        assert directions[:, 2] == pytest.approx(directions[0, 2], rel=1e-3)  # a flat picture


def test_a_panorama_is_drawn_too(tmp_path: Path) -> None:
    model = doubled_model([1, 2, 3, 4], [1, 2])
    camera = model.cameras[1]
    camera.model, camera.params = pycolmap.CameraModelId.EQUIRECTANGULAR, [100, 80]
    model.write(tmp_path)
    view = ModelView(tmp_path).camera("1.png")
    centre, corners = view.centre, view.corners
    assert np.isfinite(corners).all()
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    assert sides.min() > np.linalg.norm(corners - centre, axis=1).max() / 2  # a pyramid, not a line


def test_a_cloud_is_drawn_where_the_photograph_shows_it(tmp_path: Path) -> None:
    """Also through a model that folds a point far aside back into the picture: it is not drawn."""
    turning = Lens("SIMPLE_RADIAL", (300, 300), (-0.3,), off=(0, 0))
    lenses.model_of(dict.fromkeys(POSES, turning)).write(tmp_path)
    near, far = np.array([(0.5, 0.1, 1.0)]) * 4, np.array([(1.52365, 0, 1.0)]) * 4
    points = np.concatenate([near, far])
    fields = [*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]
    colours = [(255, 0, 0), (0, 0, 255)]
    rows = np.array([(*p, *colour) for p, colour in zip(points, colours, strict=True)], fields)
    write_rows(tmp_path / "cloud.ply", rows)
    drawn = cloud_as_seen(tmp_path / "cloud.ply", tmp_path, "a/2.png", SIZE[0])
    ((column, row),) = turning.pixels(near)
    assert drawn.shape == (*SIZE[::-1], 3)
    assert np.argwhere((drawn != 255).any(axis=2)).tolist() == [[int(row), int(column)]]
    assert drawn[int(row), int(column)].tolist() == [255, 0, 0]
