"""A wall at z = 5 with a window, which the surface closes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from colmap_ihe.dense.camera import Bool, Float32
from colmap_ihe.dense.depth_maps import depth_file, read_planes, write_map
from colmap_ihe.dense.see_through import without_seen_through
from colmap_ihe.dense.texture.mesh import Mesh

SIZE, FOCAL_PX, WALL, BEHIND = (200, 150), 200.0, 5.0, 10.0
CAMERAS = (-0.5, 0.0, 0.5)


def _wall() -> Mesh:
    """Return squares of 0.1, two faces each, of x from -2 to 2 and y from -1.5 to 1.5."""
    x, y = np.meshgrid(np.linspace(-2, 2, 41), np.linspace(-1.5, 1.5, 31))
    vertices = np.stack([x, y, np.full_like(x, WALL)], axis=-1).reshape(-1, 3).astype(np.float32)
    row = np.arange(len(vertices)).reshape(31, 41)
    a, b, c, d = (part.ravel() for part in (row[:-1, :-1], row[:-1, 1:], row[1:, :-1], row[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)]).astype(np.int32)
    return Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))


def _workspace(folder: Path, half_widths: tuple[float, float, float]) -> Path:
    """Write a model, plain photographs and the depth maps of `CAMERAS`, each of which sees a square opening of its own
    half width."""
    (folder / "images").mkdir()
    model = pycolmap.Reconstruction()
    parameters = [FOCAL_PX, SIZE[0] / 2, SIZE[1] / 2]
    lens = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=SIZE[0], height=SIZE[1], params=parameters, camera_id=1
    )
    model.add_camera_with_trivial_rig(lens)
    for number, (x, half) in enumerate(zip(CAMERAS, half_widths, strict=True), 1):
        image = pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(), [-x, 0, 0]))
        write_map(_depth(x, half), depth_file(folder, f"{number}.png"))
        Image.new("L", SIZE, 200).save(folder / f"images/{number}.png")
    (folder / "sparse").mkdir()
    model.write(folder / "sparse")
    return folder


def _depth(x: float, half_width: float) -> Float32:
    column, row = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    on_wall = np.stack([column - SIZE[0] / 2, row - SIZE[1] / 2]) * WALL / FOCAL_PX
    within = (np.abs(on_wall[0] + x) < half_width) & (np.abs(on_wall[1]) < half_width)
    return np.where(within, BEHIND, WALL).astype(np.float32)


def _inside(mesh: Mesh, half_width: float) -> Bool:
    return np.asarray((np.abs(mesh.corners().mean(axis=1)[:, :2]) < half_width).all(axis=1))


def test_a_window_is_opened_and_the_wall_stays(tmp_path: Path) -> None:
    wall = _wall()
    result = without_seen_through(wall, _workspace(tmp_path, (0.5, 0.5, 0.5)))
    assert not _inside(result, 0.45).any()  # but what lies within a pixel of the frame
    assert (~_inside(result, 0.5)).sum() == (~_inside(wall, 0.5)).sum()


def test_what_one_view_sees_through_and_two_support_stays(tmp_path: Path) -> None:
    assert len(without_seen_through(_wall(), _workspace(tmp_path, (0.5, 0, 0))).faces) == len(_wall().faces)


def test_a_hole_of_a_few_faces_stays_closed(tmp_path: Path) -> None:
    assert len(without_seen_through(_wall(), _workspace(tmp_path, (0.12, 0.12, 0.12))).faces) == len(
        _wall().faces
    )


def test_views_without_a_map_say_nothing(tmp_path: Path) -> None:
    workspace = _workspace(tmp_path, (0.5, 0.5, 0.5))
    for number in (2, 3):
        depth_file(workspace, f"{number}.png").unlink()
    assert len(without_seen_through(_wall(), workspace).faces) == len(_wall().faces)


def _without_depth(
    workspace: Path, columns: slice, rows: slice = slice(None), numbers: tuple[int, ...] = (1, 2, 3)
) -> None:
    for number in numbers:
        file = depth_file(workspace, f"{number}.png")
        depth = np.array(read_planes(file)[0])
        depth[rows, columns] = 0
        write_map(depth, file)


def test_what_lies_before_the_sky_is_cut_from_the_border(tmp_path: Path) -> None:
    workspace = _workspace(tmp_path, (0, 0, 0))
    _without_depth(workspace, slice(140, None))
    kept = without_seen_through(_wall(), workspace).corners().mean(axis=1)
    assert kept[:, 0].max() < 1.55  # the camera at x = 0.5 sees the wall up to 1.5
    assert len(kept) == (_wall().corners().mean(axis=1)[:, 0] < kept[:, 0].max() + 0.01).sum()


def test_a_hole_in_the_depth_of_a_wall_stays_closed(tmp_path: Path) -> None:
    workspace = _workspace(tmp_path, (0, 0, 0))
    _without_depth(workspace, slice(90, 110), slice(60, 90))
    assert len(without_seen_through(_wall(), workspace).faces) == len(_wall().faces)


@pytest.mark.parametrize(("grain", "cut"), [(0, True), (20, False)])
def test_a_rim_of_plain_sky_that_one_map_took_for_the_wall_is_cut(
    tmp_path: Path, grain: int, cut: bool
) -> None:
    workspace = _workspace(tmp_path, (0, 0, 0))
    _without_depth(workspace, slice(140, None), numbers=(1, 3))
    noise = np.random.default_rng(1).integers(-grain, grain + 1, SIZE[::-1])
    for number in (1, 2, 3):
        Image.fromarray((200 + noise).astype(np.uint8)).save(workspace / f"images/{number}.png")
    kept = without_seen_through(_wall(), workspace).corners().mean(axis=1)
    assert (kept[:, 0].max() < 1.55) == cut


def test_the_border_of_a_plain_wall_with_depth_stays(tmp_path: Path) -> None:
    assert len(without_seen_through(_wall(), _workspace(tmp_path, (0, 0, 0))).faces) == len(_wall().faces)


def test_a_crumb_that_hangs_by_a_corner_goes(tmp_path: Path) -> None:
    wall = _wall()
    corners = np.array([[-2.1, -1.5, WALL], [-2.1, -1.6, WALL]], np.float32)
    crumb = np.array([[0, len(wall.vertices), len(wall.vertices) + 1]], np.int32)
    vertices, faces = np.concatenate([wall.vertices, corners]), np.concatenate([wall.faces, crumb])
    mesh = Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))
    cut = without_seen_through(mesh, _workspace(tmp_path, (0, 0, 0)))
    assert len(cut.faces) == len(wall.faces)
