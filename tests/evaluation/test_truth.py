"""Errors against the truth, where the errors are known because the test made them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_demo import PHOTOGRAPHS

from colmap_ihe.errors import ProjectError
from colmap_ihe.evaluation.truth import (
    F64,
    Similarity,
    TrueImage,
    Truth,
    align_similarity,
    key_of,
    pose_errors,
    read_truth,
)

FOUNTAIN = PHOTOGRAPHS / "fountain-p11" / "gt"


def rotation_by(x: float, y: float, z: float) -> F64:
    """(3, 3) from an axis times an angle in radians."""
    return np.asarray(cv2.Rodrigues(np.array((x, y, z)))[0], np.float64)


def poses(count: int, seed: int = 0) -> dict[str, F64]:
    rng = np.random.default_rng(seed)
    result = {}
    for k in range(count):
        rotation = rotation_by(*rng.normal(scale=1.5, size=3))
        result[f"sub/view{k}"] = np.hstack((rotation, rng.normal(size=(3, 1))))
    return result


def truth_of(true_poses: dict[str, F64], extent_m: float = 10.0) -> Truth:
    images = {k: TrueImage(100, 80, np.diag((90.0, 90.0, 1.0)), pose) for k, pose in true_poses.items()}
    return Truth(images, extent_m)


def in_frame(pose: F64, model_from_world: Similarity) -> F64:
    """The same camera in another frame."""
    rotation = pose[:, :3] @ model_from_world.rotation.T
    centre = -pose[:, :3].T @ pose[:, 3]
    moved = model_from_world.scale * model_from_world.rotation @ centre + model_from_world.translation
    return np.hstack((rotation, -(rotation @ moved)[:, None]))


MOVED = Similarity(0.37, rotation_by(0.4, -1.1, 2.0), np.array((5.0, -3.0, 11.0)))


def test_a_known_similarity_is_found() -> None:
    points = np.random.default_rng(1).normal(size=(20, 3))
    found = align_similarity(points, MOVED.scale * points @ MOVED.rotation.T + MOVED.translation)
    assert found.scale == pytest.approx(MOVED.scale, rel=1e-12)
    np.testing.assert_allclose(found.rotation, MOVED.rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, MOVED.translation, atol=1e-12)


def test_no_small_change_of_the_similarity_fits_better() -> None:
    rng = np.random.default_rng(2)
    first, second = rng.normal(size=(15, 3)), rng.normal(size=(15, 3))

    def misfit(scale: float, rotation: F64, translation: F64) -> float:
        return float(np.sum((scale * first @ rotation.T + translation - second) ** 2))

    best = align_similarity(first, second)
    assert np.linalg.det(best.rotation) == pytest.approx(1)
    least = misfit(best.scale, best.rotation, best.translation)
    for step in np.vstack((np.eye(7), -np.eye(7))) * 1e-3:
        turned = rotation_by(*step[1:4]) @ best.rotation
        assert misfit(best.scale + step[0], turned, best.translation + step[4:]) > least


def test_mirrored_points_are_not_mirrored_back() -> None:
    points = np.random.default_rng(3).normal(size=(10, 3))
    assert np.linalg.det(align_similarity(points, points * (-1, 1, 1)).rotation) == pytest.approx(1)


@pytest.mark.parametrize("points", [np.eye(3)[:2], np.outer(np.arange(5.0), (1, 2, 3))])
def test_points_that_fix_no_similarity_are_refused(points: F64) -> None:
    with pytest.raises(ValueError, match="on one line"):
        align_similarity(points, points + 1)


def test_the_frame_of_the_model_does_not_matter() -> None:
    true = poses(6)
    model = {f"{name}.png": in_frame(pose, MOVED) for name, pose in true.items()}
    errors = pose_errors(model, truth_of(true))
    assert errors.rotation_error_deg < 1e-6
    assert errors.position_error_percent < 1e-9
    assert errors.world_from_model.scale == pytest.approx(1 / MOVED.scale)
    assert errors.missing == ()


def test_a_known_rotation_error_is_reported_in_degrees() -> None:
    true = poses(6)
    model = {name: in_frame(pose, MOVED) for name, pose in true.items()}
    wrong = model["sub/view2"]
    turn = rotation_by(*(np.radians(0.5) * np.array((0.6, 0.0, 0.8))))
    model["sub/view2"] = turn @ wrong  # about its own centre: the position stays right
    errors = pose_errors(model, truth_of(true))
    assert errors.rotation_deg["sub/view2"] == pytest.approx(0.5, rel=1e-6)
    assert errors.rotation_error_deg == pytest.approx(0.5 / 6, rel=1e-5)
    assert errors.position_error_percent < 1e-9


def test_a_known_position_error_is_reported_in_metres_and_percent() -> None:
    # Forty cameras, one moved by 0.2 m: the least-squares fit leaves nearly all of it to that one.
    true = poses(40, seed=4)
    model = {name: pose.copy() for name, pose in true.items()}
    model["sub/view7"][:, 3] -= model["sub/view7"][:, :3] @ (0.0, 0.2, 0.0)
    errors = pose_errors(model, truth_of(true, extent_m=20.0))
    assert 0.17 < errors.position_m["sub/view7"] < 0.2
    assert errors.position_percent["sub/view7"] == pytest.approx(errors.position_m["sub/view7"] / 20 * 100)
    assert max(e for name, e in errors.position_m.items() if name != "sub/view7") < 0.03


def test_images_that_were_not_registered_are_named() -> None:
    true = poses(5)
    model = {name: true[name] for name in list(true)[:4]}
    assert pose_errors(model, truth_of(true)).missing == ("sub/view4",)
    with pytest.raises(ProjectError, match="2 registered images"):
        pose_errors({name: true[name] for name in list(true)[:2]}, truth_of(true))


def test_keys_keep_the_folder_and_lose_the_suffix() -> None:
    assert key_of("north/a.b.png") == "north/a.b"
    assert key_of("north/a") == "north/a"


def test_strecha_files(tmp_path: Path) -> None:
    rotation = rotation_by(0.1, 0.2, 0.3)
    for k in range(2):
        rows = [" ".join(map(repr, row)) for row in rotation.tolist()]
        text = "\n".join(["900 0 400", "0 910 300", "0 0 1", "0 0 0", *rows, f"{3 * k} {4 * k} 1", "800 600"])
        (tmp_path / f"000{k}.jpg.camera").write_text(text)
    truth = read_truth(tmp_path)
    assert sorted(truth.images) == ["0000", "0001"]
    assert truth.extent_m == pytest.approx(5)
    image = truth.images["0001"]
    assert (image.width, image.height) == (800, 600)
    assert image.calibration.tolist() == [[900, 0, 400.5], [0, 910, 300.5], [0, 0, 1]]
    np.testing.assert_allclose(image.cam_from_world[:, :3], rotation.T)
    np.testing.assert_allclose(-image.cam_from_world[:, :3].T @ image.cam_from_world[:, 3], (3, 4, 1))


@pytest.mark.data
@pytest.mark.skipif(not FOUNTAIN.is_dir(), reason="fountain-p11 is not in ../shared/data")
def test_fountain_is_read() -> None:
    truth = read_truth(FOUNTAIN)
    assert len(truth.images) == 11
    assert 10 < truth.extent_m < 40
    for image in truth.images.values():
        assert image.calibration[0, 0] == pytest.approx(2759.48)
        rotation = image.cam_from_world[:, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)


def test_folders_without_readable_truth_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match="holds no truth"):
        read_truth(tmp_path)
    (tmp_path / "a.jpg.camera").write_text("1 2 3")
    with pytest.raises(ProjectError, match="3 numbers, expected 26"):
        read_truth(tmp_path)
    (tmp_path / "cameras.json").write_text(json.dumps({"cameras": {}}))
    with pytest.raises(ProjectError, match="extent_m"):
        read_truth(tmp_path)
