"""Photographs of any lens laid flat, and what stereo, fusion and texture make of them, against the truth."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lenses
import numpy as np
import pytest
import trimesh
from lenses import POSES, SIZE, WALL, Lens, fisheye
from PIL import Image

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Bool, Float64, PinholeCamera
from colmap_ihe.dense.depth_maps import camera_of, depth_file, read_planes, sgm_depth_maps
from colmap_ihe.dense.fusion import FUSION_BYTES, fuse, fusion_bytes
from colmap_ihe.dense.ply import COLOURS, columns, read_ply, write_mesh
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.dense.textured_mesh import texture_mesh
from colmap_ihe.dense.undistort import read_colour, read_grey, read_mask, sizes_of, undistort

HIDDEN = WALL.origin + 0.5 * WALL.right - 0.4 * WALL.down
"""The middle of what masks hide, to 0.4 around it."""
OFF_CENTRE = [
    Lens("SIMPLE_RADIAL", (330, 330), (-0.1,)),
    Lens("RADIAL", (330, 330), (-0.1, 0.02)),
    Lens("OPENCV", (330, 333), (-0.12, 0.03, 0.002, -0.001)),
    Lens("FULL_OPENCV", (330, 333), (-0.12, 0.03, 0.002, -0.001, 0.01, 0.02, -0.01, 0.005)),
]
FISHEYES = [
    fisheye(120, "SIMPLE_RADIAL_FISHEYE", (-0.02,)),
    fisheye(120, "RADIAL_FISHEYE", (-0.02, 0.004)),
    fisheye(120, "OPENCV_FISHEYE", (-0.02, 0.004, 0.001, -0.0005)),
    fisheye(120),
]


@dataclass(frozen=True)
class Scene:
    """A project with the lens of each photograph, its dense workspace and its cameras there."""

    root: Path
    lens: Mapping[str, Lens]
    views: Mapping[str, PinholeCamera]

    @property
    def dense(self) -> Path:
        return self.root / "dense"


def laid_flat(root: Path, chosen: list[Lens], **options: Any) -> Scene:
    lens = dict(zip(POSES, chosen, strict=True))
    lenses.make_project(root, lens)
    for name in lens:
        points, _ = lenses.seen(POSES[name], lenses.photograph_rays(lens[name]))
        mask = np.where(np.linalg.norm(points - HIDDEN, axis=1) < 0.4, 0, 255).astype(np.uint8)
        path = root / "masks" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(mask.reshape(SIZE[::-1])).save(path)
    folders = (root / "sparse", root / "grey", root / "colour", root / "dense")
    undistort(*folders, masks_dir=root / "masks", **options)
    model = pycolmap.Reconstruction(root / "dense" / "sparse")
    assert {camera.model_name for camera in model.cameras.values()} == {"PINHOLE"}
    views = {image.name: camera_of(model, image.image_id) for image in model.images.values()}
    return Scene(root, lens, views)


@pytest.fixture(scope="module", params=[OFF_CENTRE, FISHEYES], ids=["off the middle", "fisheyes"])
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return laid_flat(tmp_path_factory.mktemp("lenses"), request.param)


@pytest.fixture(scope="module")
def with_depth(scene: Scene) -> Scene:
    sgm_depth_maps(scene.dense)
    return scene


def flat_rays(view: PinholeCamera) -> Float64:
    """(N, 3) at depth one, of the pixels of a flat picture."""
    pixels = np.column_stack([lenses.centres(view.size), np.ones(np.prod(view.size))])
    return np.asarray(pixels @ np.linalg.inv(view.K).T)


def shift_of(picture: Float64, true: Float64) -> Float64:
    """(2,): how many pixels to the right and down a picture is from the true one, by least squares."""
    slopes = np.stack([slope.ravel() for slope in np.gradient(true)[::-1]], axis=1)
    return np.asarray(-np.linalg.lstsq(slopes, (picture - true).ravel(), rcond=None)[0])


def share_kept(lens: Lens, view: PinholeCamera) -> float:
    """The share of the pixels of a photograph that are on the flat picture."""
    pixels = lenses.photograph_rays(lens) @ view.K.T
    flat = pixels[:, :2] / pixels[:, 2:]
    return float(((flat > 0) & (flat < view.size)).all(axis=1).mean())


def require_true_pictures(scene: Scene) -> None:
    """Grey, colour and mask are what the camera of the workspace sees, without a pixel from beside the photograph."""
    for name, view in scene.views.items():
        rays = flat_rays(view)
        points, grey = lenses.seen(POSES[name], rays)
        outside = scene.lens[name].pixels(rays)
        assert ((outside > 0) & (outside < SIZE)).all(), name
        shape = view.size[::-1]
        found = read_grey(scene.dense / "grey" / "images" / name).astype(float)
        assert np.abs(shift_of(found, grey.reshape(shape))).max() < 0.03, name
        colour = read_colour(scene.dense / "images" / name).reshape(-1, 3)
        error = np.abs(colour - lenses.colour(points))
        assert np.median(error) < 1, name
        assert np.percentile(error, 99) < 6, name
        mask = read_mask(scene.dense, name)
        assert mask is not None
        away = np.linalg.norm(points - HIDDEN, axis=1)
        assert not mask.ravel()[away < 0.4].any()
        assert np.count_nonzero(mask.ravel()[away > 0.5] == 0) < 5  # COLMAP loses some pixels at a side


def test_pictures_and_masks_are_what_their_camera_sees(scene: Scene) -> None:
    require_true_pictures(scene)
    model = pycolmap.Reconstruction(scene.dense / "sparse")
    for image in model.images.values():
        observed = image.get_observation_points2D()
        points = np.array([model.points3D[p.point3D_id].xyz for p in observed])
        pixels, _ = scene.views[image.name].project(points)
        assert len(points) > 80
        assert np.abs(pixels - [p.xy for p in observed]).max() < 0.01
    assert sorted(sizes_of(scene.root / "sparse")) == sorted(view.size for view in scene.views.values())


def test_most_of_a_photograph_is_kept(scene: Scene) -> None:
    least = 0.84 if scene.lens["3.png"].is_fisheye else 0.96
    for name, view in scene.views.items():
        assert least < share_kept(scene.lens[name], view) < 1


def test_depth_is_that_of_the_wall(with_depth: Scene) -> None:
    for name, view in with_depth.views.items():
        depth = read_planes(depth_file(with_depth.dense, name))[0].ravel()
        rays = flat_rays(view)
        points, _ = lenses.seen(POSES[name], rays)
        held = depth > 0
        error = np.abs(depth / lenses.wall_depth(POSES[name], rays) - 1)[held]
        assert 1e-6 < np.median(error) < 0.002, f"{name}: {np.median(error):.5f}"
        assert held.mean() > 0.6
        assert not held[np.linalg.norm(points - HIDDEN, axis=1) < 0.4].any()


@pytest.mark.parametrize("in_cells", [False, True])
def test_the_cloud_is_the_wall_in_its_colours(with_depth: Scene, in_cells: bool) -> None:
    width, height = SIZE
    fuse(with_depth.dense, most_bytes=fusion_bytes(2 * width * height) if in_cells else FUSION_BYTES)
    cloud = read_ply(with_depth.dense / "fused.ply")["vertex"]
    points = columns(cloud, "xyz").astype(np.float64)
    assert len(cloud) > 0.8 * width * height
    assert np.median(np.abs((points - WALL.origin) @ WALL.normal)) < 0.005
    error = np.abs(columns(cloud, COLOURS) - lenses.colour(points))
    assert np.median(error) < 1.5
    assert np.percentile(error, 95) < 5


def wall_mesh() -> Mesh:
    """The part of the wall that all photographs see, as small faces, in grey."""
    side = 24
    s, t = (v.ravel() for v in np.meshgrid(*[np.linspace(-1.2, 1.2, side + 1)] * 2))
    vertices = WALL.origin + s[:, None] * WALL.right + t[:, None] * WALL.down
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    step = side + 1
    halves = ((corner, corner + step, corner + 1), (corner + 1, corner + step, corner + step + 1))
    faces = np.concatenate([np.stack(half, axis=1) for half in halves]).astype(np.int32)
    return Mesh(vertices.astype(np.float32), faces, np.full(vertices.shape, 77, np.uint8))


def test_the_texture_has_the_colours_of_the_wall(scene: Scene) -> None:
    write_mesh(scene.dense / "mesh.ply", wall_mesh())
    with ThreadPoolExecutor(1) as executor:
        texture = texture_mesh(scene.dense, scene.dense / "mesh.ply", 2048, executor=executor)
    assert 0 < texture.faces_unseen < 200  # what the masks hide in all of them, of 1152
    surface: Any = trimesh.load(scene.dense / "mesh.obj", process=False, maintain_order=True)
    picture = np.asarray(surface.visual.material.image.convert("RGB"), float)
    u, v = surface.visual.uv[surface.faces].mean(axis=1).T
    row, column = ((1 - v) * picture.shape[0]).astype(int), (u * picture.shape[1]).astype(int)
    middles = np.asarray(surface.vertices[surface.faces].mean(axis=1))
    error = np.abs(picture[row, column] - lenses.colour(middles)).max(axis=1)
    shown: Bool = np.linalg.norm(middles - HIDDEN, axis=1) > 0.65
    assert np.median(error[shown]) < 2
    assert np.percentile(error[shown], 99) < 6


ZERO = [Lens("PINHOLE", (330, 333)), Lens("OPENCV", (330, 333), (0.0,) * 4), fisheye(120), fisheye(110)]


@pytest.mark.parametrize("most", [-1, 200])
def test_cameras_without_distortion_are_laid_flat_too(tmp_path: Path, most: int) -> None:
    """COLMAP keeps such cameras, and their photographs: also of a fisheye, and masks of another size."""
    scene = laid_flat(tmp_path, ZERO, max_image_size=most)
    for name, view in scene.views.items():
        assert (
            max(view.size) == 200 if most == 200 else view.K[0, 0] == pytest.approx(scene.lens[name].focal[0])
        )
        assert read_grey(scene.dense / "grey" / "images" / name).shape == view.size[::-1]
    if most == -1:
        require_true_pictures(scene)
    assert not (tmp_path / "dense" / ".parts").exists()


def test_of_a_very_wide_fisheye_the_middle_is_laid_flat(tmp_path: Path) -> None:
    """COLMAP has wrong rays at 90 degrees and more, and by these it keeps 50 % and 46 % of such photographs."""
    half, more = (fisheye(degrees, distortion=(0.002, 0.0, 0.0, 0.0)) for degrees in (180, 200))
    scene = laid_flat(tmp_path, [half, more, OFF_CENTRE[2], half])
    require_true_pictures(scene)
    for name, view in scene.views.items():
        lens = scene.lens[name]
        least = {half: 0.62, more: 0.5}.get(lens, 0.96)
        assert least < share_kept(lens, view) < least + 0.06, name
        corners = view.corners() @ np.linalg.inv(view.K).T
        assert np.degrees(np.arctan(np.linalg.norm(corners[:, :2], axis=1))).max() < 80
