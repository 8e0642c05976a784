"""The simulated sets of benchmarks/lens_sets.py: what their databases hold follows from the truth that they give."""

from __future__ import annotations

from pathlib import Path

import lens_kinds
import numpy as np
import pytest
from lens_features import sight
from lens_scenes import Panels, pose
from lens_sets import position_error_mm, simulate, write_camera_model

from colmap_ihe.colmap.native import pycolmap


def test_without_noise_the_verified_pairs_agree_with_the_true_lens_and_poses(tmp_path: Path) -> None:
    made = simulate(tmp_path, "object", "complex+1", 3, seed=4, noise_px=0, points=300)
    assert np.hypot(
        made.truth.principal_point_x - 800, made.truth.principal_point_y - 533.5
    ) == pytest.approx(16)
    with pycolmap.Database.open(made.database) as opened:
        rays = [np.asarray(made.truth.cam_from_img(opened.read_keypoints(i)[:, :2])) for i in (1, 2)]
        inliers = opened.read_two_view_geometry(1, 2).inlier_matches
        matches = opened.read_matches(1, 2)
    first, second = (pycolmap.Rigid3d(matrix) for matrix in list(made.poses.values())[:2])
    essential = pycolmap.essential_matrix_from_pose(second * first.inverse())
    left, right = (np.column_stack([rays[side][inliers[:, side]], np.ones(len(inliers))]) for side in (0, 1))
    off = np.abs(np.einsum("ni,ij,nj->n", right, essential / np.linalg.norm(essential), left))
    assert 60 < len(inliers) < len(matches)
    assert np.quantile(off, 0.9) < 1e-6


def test_one_seed_gives_one_set(tmp_path: Path) -> None:
    keypoints = []
    for folder in ("a", "b"):
        made = simulate(tmp_path / folder, "facade", "barrel", 3, seed=2, points=200)
        with pycolmap.Database.open(made.database) as opened:
            keypoints.append(opened.read_keypoints(2))
    assert np.array_equal(keypoints[0], keypoints[1])


def test_what_colmap_begins_with_knows_neither_distortion_nor_principal_point(tmp_path: Path) -> None:
    made = simulate(tmp_path, "facade", "barrel", 3, seed=2, points=200)
    with pycolmap.Database.open(made.database) as opened:
        camera = opened.read_camera(1)
    assert camera.model_name == "SIMPLE_RADIAL"
    assert camera.params[1:].tolist() == [800, 533.5, 0]
    assert camera.has_prior_focal_length
    assert camera.focal_length == pytest.approx(made.truth.focal_length, rel=0.015)
    write_camera_model(made.database, "OPENCV")
    with pycolmap.Database.open(made.database) as opened:
        changed = opened.read_camera(1)
    assert changed.params.tolist() == [camera.focal_length] * 2 + [800, 533.5, 0, 0, 0, 0]
    assert changed.has_prior_focal_length


def test_without_exif_the_focal_length_is_guessed(tmp_path: Path) -> None:
    made = simulate(tmp_path, "street", "none", 2, seed=1, points=100, prior_focal=False)
    with pycolmap.Database.open(made.database) as opened:
        camera = opened.read_camera(1)
    assert (camera.focal_length, camera.has_prior_focal_length) == (1.2 * 1600, False)


def test_nothing_is_found_behind_a_nearer_panel() -> None:
    across, up = np.array([[8.0, 0, 0], [4.0, 0, 0]]), np.array([[0, 0, 6.0], [0, 0, 6.0]])
    wall_and_screen = Panels(np.array([[-4.0, 6, -3], [-4.0, 3, -3]]), across, up, np.array([1.0, 0.1]))
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 800, 1600, 1067)
    sightings = sight(wall_and_screen, camera, [pose((0, 0, 0), 0, 0)], 500, np.random.default_rng(1))
    points = sightings.features.points[sightings.found[0]]
    on_wall = points[:, 1] > 5
    assert on_wall.sum() > 100
    assert (points[on_wall, 0] > -1e-6).all()


def test_the_position_error_is_what_a_similarity_leaves() -> None:
    model = pycolmap.synthesize_dataset(pycolmap.SyntheticDatasetOptions(num_frames_per_rig=5))
    turn = pycolmap.Rotation3d(np.array([0.1, -0.2, 0.3])).matrix()
    poses = {}
    for image in model.images.values():
        centre = 2 * turn @ image.projection_center() + (1, 2, 3)
        poses[image.name] = np.column_stack([np.eye(3), -centre])
    assert position_error_mm(model, poses) == pytest.approx(0, abs=1e-6)
    moved = next(iter(poses))
    poses[moved][:, 3] -= (0.001, 0, 0)
    assert 0.1 < position_error_mm(model, poses) < 0.5
    for image_id in model.reg_image_ids()[2:]:
        model.deregister_frame(model.images[image_id].frame_id)
    assert np.isnan(position_error_mm(model, poses))


def test_a_lens_that_folds_or_is_unknown_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    folding = lens_kinds.Lens("SIMPLE_RADIAL", (0.75, 0.76), lambda _rng: (-0.9,))
    monkeypatch.setattr(lens_kinds, "LENSES", {"folding": folding})
    with pytest.raises(ValueError, match="folds within the picture"):
        lens_kinds.true_camera("folding", (1600, 1067), np.random.default_rng(1))
    with pytest.raises(ValueError, match="take one of folding"):
        lens_kinds.true_camera("round", (1600, 1067), np.random.default_rng(1))
