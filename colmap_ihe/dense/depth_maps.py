"""Make the depth and normal maps of a COLMAP dense workspace, one image at a time, by matching on the CPU.

Every image is an independent job, so any `concurrent.futures.Executor` runs them.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Array, Float32, Float64, PinholeCamera
from colmap_ihe.dense.sparse_points import SparsePoints, sparse_points
from colmap_ihe.dense.stereo.depth import depth_and_normals
from colmap_ihe.dense.stereo.sources import choose_sources
from colmap_ihe.dense.stereo.views import StereoView
from colmap_ihe.dense.undistort import read_grey, read_mask
from colmap_ihe.errors import Cancelled, ProjectError
from colmap_ihe.machine.executor import TaskProgress, in_order
from colmap_ihe.machine.files import replace_file, require_same_folder
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import cores


@dataclass
class DepthCounts:
    """Count what a run over all depth maps left, for the record. Pairs are named "REFERENCE | SOURCE"."""

    images: int = 0
    pixels: int = 0
    pixels_with_depth: int = 0
    empty: list[str] = field(default_factory=list)
    pairs_used: int = 0
    pairs_left_out: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Job:
    """Hold all that one depth map needs: small enough to be sent to another machine that sees the same folder. The
    first name and camera are the reference's."""

    dense_dir: Path
    names: tuple[str, ...]
    cameras: tuple[PinholeCamera, ...]
    points_world: Float64


_Counts = tuple[str, int, int, dict[str, str]]


def sgm_depth_maps(
    dense_dir: Path,
    *,
    sources_per_image: int = 5,
    executor: Executor | None = None,
    at_once: int | None = None,
    progress: Progress = SILENT,
    only: Collection[str] = (),
) -> DepthCounts:
    """Make the depth and normal maps of every image of `dense_dir`, or `only` of those named, by semi-global matching
    on the CPU.

    Keeps a map that exists already: the caller sees to it that the folder belongs to the same inputs. Works on
    `at_once` at most at a time, on all cores without an `executor`. When `progress` cancels, the maps under way stop
    within one pair's time and the finished ones stay.
    """
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    cameras = {image_id: camera_of(model, image_id) for image_id in sorted(model.reg_image_ids())}
    names = {image_id: str(model.images[image_id].name) for image_id in cameras}
    references = [image_id for image_id in cameras if not only or names[image_id] in only]
    points = sparse_points(model, progress)
    counts = DepthCounts()
    jobs = []
    progress.start(len(references), "depth maps planned")
    plan = partial(_plan, dense_dir, names, cameras, points, sources_per_image)
    with ThreadPoolExecutor(cores()) as threads:
        for job, left_out in in_order(threads, plan, references, progress=progress):
            jobs.append(job)
            counts.pairs_used += len(job.names) - 1
            for image_id, reason in left_out.items():
                counts.pairs_left_out[f"{job.names[0]} | {names[image_id]}"] = reason
            progress.advance()
    for unfinished in (dense_dir / "stereo").rglob("*.part"):
        unfinished.unlink()
    progress.start(len(jobs), "depth maps")
    with nullcontext(executor) if executor else ThreadPoolExecutor(cores()) as workers:
        _run_all(jobs, _stop_file(dense_dir), workers, at_once or len(jobs), counts, progress)
    return counts


def _plan(
    dense_dir: Path,
    names: Mapping[int, str],
    cameras: Mapping[int, PinholeCamera],
    points: SparsePoints,
    count: int,
    reference: int,
) -> tuple[_Job, dict[int, str]]:
    """Return the depth map of image id `reference` as a job, and the sources that were left out, with the reason."""
    points_world, rows, images = points.seen_from(reference)
    chosen, left_out = choose_sources(reference, cameras, points_world, rows, images, count)
    members = (reference, *chosen)
    own_names = tuple(names[image_id] for image_id in members)
    return _Job(dense_dir, own_names, tuple(cameras[key] for key in members), points_world), left_out


def _run_all(
    jobs: list[_Job],
    stop_file: Path,
    executor: Executor,
    at_once: int,
    counts: DepthCounts,
    progress: Progress,
) -> None:
    """Make every depth map, and count; on cancellation tell the workers through a file, wherever they run."""
    stop_file.unlink(missing_ok=True)
    waiting: set[Future[_Counts]] = set()
    left = jobs[::-1]
    try:
        while waiting or left:
            while left and len(waiting) < at_once:
                waiting.add(executor.submit(_make_maps, left.pop()))
            done, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
            progress.check()
            for future in done:
                name, pixels, with_depth, left_out = future.result()
                counts.images += 1
                counts.pixels += pixels
                counts.pixels_with_depth += with_depth
                counts.pairs_left_out.update(left_out)
                if not with_depth:
                    counts.empty.append(name)
                progress.advance()
    except BaseException:
        if waiting:
            stop_file.touch()
        for future in waiting:
            future.cancel()
        wait(waiting)
        raise
    finally:
        stop_file.unlink(missing_ok=True)


def _make_maps(job: _Job) -> _Counts:
    """Write the maps of one reference, unless they exist. Return its name, its pixels, those with depth, and the pairs
    left out with the reason."""
    name = job.names[0]
    depth_path, normal_path = depth_file(job.dense_dir, name), normal_file(job.dense_dir, name)
    stop_file = _stop_file(job.dense_dir)

    def check() -> None:
        TaskProgress().check()
        if stop_file.exists():
            raise Cancelled

    check()
    left_out: dict[str, str] = {}
    if not (depth_path.is_file() and normal_path.is_file()):
        reference, *sources = (_view(job, index) for index in range(len(job.names)))
        result = depth_and_normals(reference, sources, job.points_world, check)
        for index, reason in result.pairs_left_out.items():
            left_out[f"{name} | {job.names[1 + index]}"] = reason
        write_map(result.normals, normal_path)
        write_map(result.depth, depth_path)
    depth = read_planes(depth_path)[0]
    return name, depth.size, int(np.count_nonzero(depth)), left_out


def _view(job: _Job, index: int) -> StereoView:
    name, camera = job.names[index], job.cameras[index]
    grey_u8 = read_grey(job.dense_dir / "grey" / "images" / name)
    return StereoView(camera.K, camera.cam_from_world, camera.size, grey_u8, read_mask(job.dense_dir, name))


def camera_of(model: pycolmap.Reconstruction, image_id: int) -> PinholeCamera:
    """Return the camera of an undistorted image, with its pose."""
    image = model.images[image_id]
    camera = model.cameras[image.camera_id]
    size = (camera.width, camera.height)
    return PinholeCamera(camera.calibration_matrix(), image.cam_from_world().matrix(), size)


def depth_file(dense_dir: Path, name: str) -> Path:
    """Return the path of an image's depth map."""
    return dense_dir / "stereo" / "depth_maps" / f"{name}.geometric.bin"


def normal_file(dense_dir: Path, name: str) -> Path:
    """Return the path of an image's normal map."""
    return dense_dir / "stereo" / "normal_maps" / f"{name}.geometric.bin"


def read_planes(path: Path) -> Float32:
    """Return (C, H, W) float32 of a map in COLMAP's format, as `write_map` writes it; read from the disk when used.

    Raises `ProjectError`.
    """
    try:
        with path.open("rb") as handle:
            width, height, channels = (int(n) for n in handle.read(64).split(b"&")[:3])
        head = len(f"{width}&{height}&{channels}&")
        return np.memmap(path, np.dtype("<f4"), "r", head, (channels, height, width))
    except (OSError, ValueError) as error:
        raise ProjectError(
            f"{path}: cannot be read as a depth or normal map of COLMAP ({error})",
            hint="run the dense stage again with --from dense",
        ) from error


@dataclass(frozen=True)
class DepthMap:
    """Hold what a photograph measured: its `camera`, `read`, which returns (H, W) float32 depths along the optical
    axis, 0 for none, and the file of the undistorted `photograph`."""

    camera: PinholeCamera
    read: Callable[[], Float32]
    photograph: Path


def depth_maps(dense_dir: Path) -> list[DepthMap]:
    """Return the depth maps that a COLMAP dense workspace has, by name. Reading one raises `ProjectError`."""
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    names = {str(model.images[number].name): number for number in model.reg_image_ids()}
    files = {name: depth_file(dense_dir, name) for name in sorted(names)}
    return [
        DepthMap(camera_of(model, names[name]), partial(_depth, file), dense_dir / "images" / name)
        for name, file in files.items()
        if file.is_file()
    ]


def _depth(file: Path) -> Float32:
    return np.asarray(read_planes(file)[0])


def write_map(values: Array, path: Path) -> None:
    """Write (H, W) or (H, W, C) float32 in COLMAP's format of depth and normal maps, atomically.

    The text "W&H&C&", then channel after channel, row after row, little-endian (COLMAP, `mvs/mat.h`).
    Not by pycolmap 4.2's NormalMap.from_array, which writes the channels of each pixel side by side:
    fusion reads such a file as noise.
    """
    planes = np.atleast_3d(values).transpose(2, 0, 1).astype("<f4")
    channels, height, width = planes.shape
    require_same_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{secrets.token_hex(4)}.part")  # no other worker's
    part.write_bytes(f"{width}&{height}&{channels}&".encode() + planes.tobytes())
    replace_file(part, path)


def _stop_file(dense_dir: Path) -> Path:
    return dense_dir / "stereo" / ".stop"
