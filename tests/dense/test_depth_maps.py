"""The dense stage on a small workspace with known truth: a slanted plane in five views with awkward names."""

from __future__ import annotations

import shutil
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from doubled import doubled_model
from numpy.typing import NDArray
from PIL import Image
from plane import COLOUR, NORMAL, SIZE, VIEWS, make_project, plane_depth
from running import StopsWhen

from colmap_ihe.colmap.native import cuda_devices, pycolmap
from colmap_ihe.dense import backend as dense
from colmap_ihe.dense import depth_maps
from colmap_ihe.dense.depth_maps import DepthCounts, sgm_depth_maps, write_map
from colmap_ihe.dense.fusion import fuse
from colmap_ihe.dense.ply import COLOURS, columns, read_ply
from colmap_ihe.dense.sparse_points import sparse_points
from colmap_ihe.dense.undistort import read_colour, undistort
from colmap_ihe.errors import Cancelled, CapabilityError, OptionError, ProjectError

NAMES = list(VIEWS)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """sparse/, grey/, colour/ and the finished dense/ of the plane."""
    root = tmp_path_factory.mktemp("dénse project")
    make_project(root)
    undistort(root / "sparse", root / "grey", root / "colour", root / "dense")
    return root


def _depth(project: Path, name: str) -> NDArray[np.float32]:
    written = pycolmap.DepthMap()
    written.read(project / "dense" / "stereo" / "depth_maps" / f"{name}.geometric.bin")
    return written.to_array()


def test_only_the_maps_that_are_named_are_made(project: Path, tmp_path: Path) -> None:
    dense = tmp_path / "dense"
    shutil.copytree(
        project / "dense", dense, ignore=shutil.ignore_patterns("*.bin.part", "depth_maps", "normal_maps")
    )
    assert sgm_depth_maps(dense, only=[NAMES[1]]).images == 1
    made = (dense / "stereo" / "depth_maps").rglob("*.bin")
    assert list(made) == [dense / "stereo" / "depth_maps" / f"{NAMES[1]}.geometric.bin"]


@pytest.fixture(scope="module")
def counts(project: Path) -> DepthCounts:
    return sgm_depth_maps(project / "dense")


def test_the_workspace_is_a_plain_one_in_colour_with_a_grey_twin(project: Path) -> None:
    for name in NAMES:
        colour = np.asarray(Image.open(project / "dense" / "images" / name).convert("RGB"), float)
        grey = np.asarray(Image.open(project / "dense" / "grey" / "images" / name).convert("L"), float)
        assert colour.shape[:2] == grey.shape == SIZE[::-1]
        assert np.abs(colour - grey[..., None] * COLOUR).max() <= 1
    model = pycolmap.Reconstruction(project / "dense" / "sparse")
    assert model.num_reg_images() == len(NAMES)
    assert (project / "dense" / "stereo" / "fusion.cfg").read_text().split("\n")[: len(NAMES)]


def test_the_folder_is_what_gaussian_splatting_reads(project: Path) -> None:
    """`images/` in colour and `sparse/0` with pinhole cameras, as COLMAP's binary files: read by their layout."""
    model = project / "dense" / "sparse" / "0"
    cameras = (model / "cameras.bin").read_bytes()
    (count,) = struct.unpack_from("<Q", cameras)
    assert len(cameras) == 8 + count * (24 + 4 * 8)  # id, model, width, height; fx, fy, cx, cy
    pinhole = 1
    read = [struct.unpack_from("<iiQQ4d", cameras, 8 + n * 56) for n in range(count)]
    assert {(kind, width, height) for _, kind, width, height, *_ in read} == {(pinhole, *SIZE)}
    images = (model / "images.bin").read_bytes()
    assert all(name.encode() + b"\0" in images for name in NAMES)
    colours = [read_colour(project / "dense" / "images" / name) for name in NAMES]
    assert all(np.ptp(picture, axis=2).max() > 20 for picture in colours)
    for file in model.iterdir():
        assert file.read_bytes() == (model.parent / file.name).read_bytes()


def test_depth_maps_are_the_plane(project: Path, counts: DepthCounts) -> None:
    assert counts.images == len(NAMES)
    assert counts.pixels == len(NAMES) * SIZE[0] * SIZE[1]
    assert counts.empty == []
    assert 0.85 < counts.pixels_with_depth / counts.pixels < 1.0
    for name, centre in VIEWS.items():
        depth = _depth(project, name)
        held = depth > 0
        errors = np.abs(depth[held] / plane_depth(centre)[held] - 1)
        assert depth.shape == SIZE[::-1]
        assert 1e-6 < np.median(errors) < 0.002, f"{name}: {np.median(errors):.5f}"


@pytest.mark.usefixtures("counts")
def test_fusion_keeps_its_normal_check_and_has_colour(project: Path) -> None:
    strict = fuse(project / "dense", options={"max_normal_error": 10.0})
    cloud = read_ply(project / "dense" / "fused.ply")["vertex"]
    assert len(cloud) == strict
    loose = fuse(project / "dense", options={"max_normal_error": 180.0})
    assert strict > 0.9 * loose
    # One point a pixel of the union of the views, which is about one view and a half.
    assert 60_000 < strict < 200_000
    points = columns(cloud, "xyz")
    distance = np.abs((points - [0, 0, 4]) @ NORMAL)
    assert np.percentile(distance, 90) < 0.02, f"{np.percentile(distance, 90):.4f} at a distance of 4"
    normals = columns(cloud, ("nx", "ny", "nz"))
    angles = np.degrees(np.arccos(np.clip(normals @ NORMAL, -1, 1)))
    assert np.median(angles) < 3
    colour = columns(cloud, COLOURS).mean(axis=0)
    assert colour / colour[0] == pytest.approx(np.array(COLOUR) / COLOUR[0], abs=0.02)
    assert (project / "dense" / "fused.ply.vis").stat().st_size > 0
    assert not list((project / "dense").glob("*.part*"))


def test_maps_that_are_there_are_kept_and_missing_ones_made(project: Path, counts: DepthCounts) -> None:
    folder = project / "dense" / "stereo" / "depth_maps"
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.bin")}
    missing = folder / f"{NAMES[1]}.geometric.bin"
    content = missing.read_bytes()
    missing.unlink()
    with ThreadPoolExecutor(1) as executor:
        again = sgm_depth_maps(project / "dense", executor=executor)
    assert again == counts
    assert missing.read_bytes() == content
    after = {path: path.stat().st_mtime_ns for path in folder.rglob("*.bin")}
    assert {path for path in before if before[path] != after[path]} == {missing}


def test_cancelled_depth_maps_leave_whole_files_only(project: Path, counts: DepthCounts) -> None:
    folder = project / "dense" / "stereo"
    contents = {path: path.read_bytes() for path in folder.rglob("*.geometric.bin")}
    for path in contents:
        path.unlink()
    after_one = StopsWhen(lambda done: done > 2 * len(NAMES))  # all are listed and planned before
    with pytest.raises(Cancelled), ThreadPoolExecutor(1) as executor:
        sgm_depth_maps(project / "dense", executor=executor, progress=after_one)
    left = [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".cfg"]
    assert 0 < len(left) < len(contents)
    assert all(path.read_bytes() == contents[path] for path in left)
    assert sgm_depth_maps(project / "dense") == counts
    assert {path: path.read_bytes() for path in folder.rglob("*.geometric.bin")} == contents


@pytest.mark.usefixtures("counts")
def test_a_map_under_way_is_told_to_stop(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started, stopped = [], []

    def endless(*arguments: object) -> None:
        check = arguments[-1]
        assert callable(check)
        started.append(True)
        end = time.monotonic() + 10
        try:
            while time.monotonic() < end:
                check()
                time.sleep(0.02)
        except Cancelled:
            stopped.append(True)
            raise

    missing = project / "dense" / "stereo" / "depth_maps" / f"{NAMES[4]}.geometric.bin"
    content = missing.read_bytes()
    missing.unlink()
    monkeypatch.setattr(depth_maps, "depth_and_normals", endless)
    with pytest.raises(Cancelled), ThreadPoolExecutor(1) as executor:
        sgm_depth_maps(project / "dense", executor=executor, progress=StopsWhen(lambda _: started))
    assert len(stopped) == 1
    assert not (project / "dense" / "stereo" / ".stop").exists()
    missing.write_bytes(content)


def test_undistortion_can_shrink(project: Path, tmp_path: Path) -> None:
    folders = (project / "sparse", project / "grey", project / "colour")
    assert undistort(*folders, tmp_path / "dense", max_image_size=160).keys() == set(NAMES)
    for workspace in (tmp_path / "dense", tmp_path / "dense" / "grey"):
        with Image.open(workspace / "images" / NAMES[0]) as image:
            assert image.size == (160, 120)


def test_a_missing_colour_twin_is_named(project: Path, tmp_path: Path) -> None:
    colour = Path(shutil.copytree(project / "colour", tmp_path / "colour"))
    (colour / NAMES[-1]).unlink()
    with pytest.raises(ProjectError, match=r"1 of 5 images of the model .* first e\.png"):
        undistort(project / "sparse", project / "grey", colour, tmp_path / "dense")


def test_cancelling_is_heard(project: Path, tmp_path: Path) -> None:
    progress = StopsWhen(lambda _: True)
    folders = (project / "sparse", project / "grey", project / "colour", tmp_path / "dense")
    with pytest.raises(Cancelled):
        undistort(*folders, progress=progress)
    for work in (sgm_depth_maps, fuse):
        with pytest.raises(Cancelled):
            work(project / "dense", progress=progress)


def test_maps_are_written_as_colmap_reads_them(tmp_path: Path) -> None:
    depth = np.arange(12, dtype=np.float32).reshape(3, 4) + 1
    write_map(depth, tmp_path / "depth.bin")
    written = pycolmap.DepthMap()
    written.read(tmp_path / "depth.bin")
    assert np.array_equal(written.to_array(), depth)
    normals = np.zeros((3, 4, 3), np.float32)
    normals[..., 2] = -1
    write_map(normals, tmp_path / "normals.bin")
    normal_map = pycolmap.NormalMap()
    normal_map.read(tmp_path / "normals.bin")
    # COLMAP draws a normal n as 127.5 (1 - n): its own reading of the file, unlike to_array in pycolmap 4.2.
    picture = normal_map.to_bitmap().to_array().reshape(-1, 3)
    assert (picture == picture[0]).all()
    assert picture[0, 2] > 250
    # The format as in COLMAP's scripts/python/read_write_dense.py: columns fastest, then rows, then channels.
    content = (tmp_path / "normals.bin").read_bytes()
    assert content[:6] == b"4&3&3&"
    written_normals = np.frombuffer(content[6:], "<f4").reshape((4, 3, 3), order="F").transpose(1, 0, 2)
    assert np.array_equal(written_normals, normals)


def test_backends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pycolmap, "has_cuda", False)
    assert dense.pick_backend("auto") == "sgm"
    assert dense.pick_backend("sgm") == "sgm"
    with pytest.raises(CapabilityError, match="needs CUDA") as caught:
        dense.pick_backend("patchmatch")
    assert "pycolmap-cuda12" in caught.value.hint
    monkeypatch.setattr(pycolmap, "has_cuda", True)  # the wheel with CUDA, where no driver finds a device
    no_driver = Mock(side_effect=OSError("libcuda.so.1: cannot open shared object file"))
    drivers = [no_driver, *(Mock(return_value=d) for d in (driver(2, error=100), driver(0), driver(2)))]
    for loads, devices in zip(drivers, (0, 0, 0, 2), strict=True):
        monkeypatch.setattr("ctypes.CDLL", loads)
        assert cuda_devices() == devices
        assert dense.pick_backend("auto") == ("patchmatch" if devices else "sgm")
    assert dense.pick_backend("sgm") == "sgm"


def driver(devices: int, error: int = 0) -> SimpleNamespace:
    """Stand for CUDA's driver, with its answers."""
    return SimpleNamespace(
        cuInit=lambda _flags: error, cuDeviceGetCount=lambda count: setattr(count._obj, "value", devices)
    )


def test_an_unknown_fusion_option_is_refused(project: Path) -> None:
    with pytest.raises(OptionError, match=r"dense\.colmap"):
        fuse(project / "dense", options={"min_pixels": 3})


def test_a_photograph_with_two_observations_of_a_point_counts_once_as_a_source(tmp_path: Path) -> None:
    model = doubled_model(*[[1, 2]] * 30, *[[1, 1, 3, 3]] * 20, images=3)
    cameras = {image_id: depth_maps.camera_of(model, image_id) for image_id in (1, 2, 3)}
    names = {number: f"{number}.png" for number in cameras}
    job, _ = depth_maps._plan(tmp_path, names, cameras, sparse_points(model), 1, 1)
    assert job.names == ("1.png", "2.png")
    assert len(job.points_world) == 50
