"""The depth and normal maps of a COLMAP dense workspace, one image at a time, by matching on the CPU.

Every image is one job that knows nothing of the others, so any `concurrent.futures.Executor` runs them.
"""

from __future__ import annotations

import os
import secrets
from collections import deque
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.stereo.depth import StereoOptions, depth_and_normals
from colmap_ihe.dense.stereo.sources import Sources, choose_sources
from colmap_ihe.dense.stereo.views import Array, Float32, Float64, StereoCamera, StereoView
from colmap_ihe.dense.undistort import read_grey, read_mask
from colmap_ihe.errors import Cancelled, ProjectError
from colmap_ihe.machine.executor import TaskProgress
from colmap_ihe.machine.files import require_same_folder
from colmap_ihe.machine.progress import SILENT, Progress


@dataclass
class DepthCounts:
    """What a run over all depth maps left: for the record. Pairs are named "REFERENCE | SOURCE"."""

    images: int = 0
    pixels: int = 0
    pixels_with_depth: int = 0
    empty: list[str] = field(default_factory=list)
    pairs_used: int = 0
    pairs_left_out: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Job:
    """All that one depth map needs: small enough to be sent to another machine that sees the same folder.

    The first name and camera are the reference's.
    """

    dense_dir: Path
    names: tuple[str, ...]
    cameras: tuple[StereoCamera, ...]
    points_world: Float64
    options: StereoOptions


_Made = tuple[int, int, dict[str, str]]


def sgm_depth_maps(
    dense_dir: Path,
    *,
    sources_per_image: int = 5,
    options: StereoOptions | None = None,
    executor: Executor | None = None,
    at_once: int | None = None,
    progress: Progress = SILENT,
) -> DepthCounts:
    """Depth and normal maps of every image of `dense_dir` by semi-global matching on the CPU.

    A map that is already there is kept: the caller sees to it that the folder belongs to the same
    inputs. No more than `at_once` are worked on at a time. When `progress` cancels, the maps under way stop
    within one pair's time and the finished ones stay.
    """
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    cameras = {image_id: _camera(model, image_id) for image_id in sorted(model.reg_image_ids())}
    counts = DepthCounts()
    jobs = []
    for reference in cameras:
        progress.check()
        job, sources = _plan(
            dense_dir, model, cameras, reference, sources_per_image, options or StereoOptions()
        )
        jobs.append(job)
        counts.pairs_used += len(sources.chosen)
        for image_id, reason in sources.left_out.items():
            counts.pairs_left_out[f"{job.names[0]} | {model.images[image_id].name}"] = reason
    for unfinished in (dense_dir / "stereo").rglob("*.part"):
        unfinished.unlink()
    progress.start(len(jobs), "depth maps")
    if executor is None:
        with ThreadPoolExecutor(os.cpu_count()) as own:
            _run_all(jobs, own, at_once, counts, progress)
    else:
        _run_all(jobs, executor, at_once, counts, progress)
    return counts


def _plan(
    dense_dir: Path,
    model: pycolmap.Reconstruction,
    cameras: Mapping[int, StereoCamera],
    reference: int,
    count: int,
    options: StereoOptions,
) -> tuple[_Job, Sources]:
    """The depth map of image id `reference` as a job."""
    ids = [point.point3D_id for point in model.images[reference].get_observation_points2D()]
    points = [model.points3D[point_id] for point_id in ids]
    points_world = np.array([point.xyz for point in points]).reshape(-1, 3)
    seen = [(row, element.image_id) for row, point in enumerate(points) for element in point.track.elements]
    rows, images = np.array(seen, np.int64).reshape(-1, 2).T
    sources = choose_sources(reference, cameras, points_world, rows, images, count)
    members = (reference, *sources.chosen)
    names = tuple(model.images[image_id].name for image_id in members)
    return _Job(dense_dir, names, tuple(cameras[key] for key in members), points_world, options), sources


def _run_all(
    jobs: list[_Job], executor: Executor, at_once: int | None, counts: DepthCounts, progress: Progress
) -> None:
    """Makes every depth map, and counts; on cancellation tells the workers through a file, wherever they
    run.
    """
    stop_file = _stop_file(jobs[0].dense_dir) if jobs else None
    if stop_file:
        stop_file.unlink(missing_ok=True)
    names: dict[Future[_Made], str] = {}
    waiting: set[Future[_Made]] = set()
    left = deque(jobs)
    try:
        while waiting or left:
            while left and len(waiting) < (at_once or len(jobs)):
                job = left.popleft()
                future = executor.submit(_make_maps, job)
                names[future] = job.names[0]
                waiting.add(future)
            done, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
            progress.check()
            for future in done:
                pixels, with_depth, left_out = future.result()
                counts.images += 1
                counts.pixels += pixels
                counts.pixels_with_depth += with_depth
                counts.pairs_left_out.update(left_out)
                if not with_depth:
                    counts.empty.append(names[future])
                progress.advance()
    except BaseException:
        if stop_file:
            stop_file.touch()
        for future in waiting:
            future.cancel()
        wait(waiting)
        raise
    finally:
        if stop_file:
            stop_file.unlink(missing_ok=True)


def _make_maps(job: _Job) -> _Made:
    """Writes the depth and normal map of one reference, unless they are there.

    Returns its pixels, those with depth, and the pairs left out with the reason.
    """
    depth_path = depth_file(job.dense_dir, job.names[0])
    normal_path = normal_file(job.dense_dir, job.names[0])
    stop_file = _stop_file(job.dense_dir)

    def check() -> None:
        TaskProgress().check()
        if stop_file.exists():
            raise Cancelled

    check()
    left_out: dict[str, str] = {}
    if not (depth_path.is_file() and normal_path.is_file()):
        views = [_view(job, place) for place in range(len(job.names))]
        result = depth_and_normals(views[0], views[1:], job.points_world, job.options, check)
        for place, reason in result.pairs_left_out.items():
            left_out[f"{job.names[0]} | {job.names[1 + place]}"] = reason
        write_map(result.normals, normal_path)
        write_map(result.depth, depth_path)
    depth = read_depth(depth_path)
    return depth.size, int(np.count_nonzero(depth)), left_out


def _view(job: _Job, place: int) -> StereoView:
    name, camera = job.names[place], job.cameras[place]
    grey_u8 = read_grey(job.dense_dir / "grey" / "images" / name)
    return StereoView(camera.K, camera.cam_from_world, camera.size, grey_u8, read_mask(job.dense_dir, name))


def _camera(model: pycolmap.Reconstruction, image_id: int) -> StereoCamera:
    image = model.images[image_id]
    camera = model.cameras[image.camera_id]
    return StereoCamera(
        camera.calibration_matrix(), image.cam_from_world().matrix(), (camera.width, camera.height)
    )


def depth_file(dense_dir: Path, name: str) -> Path:
    """Where the depth map of an image lies."""
    return dense_dir / "stereo" / "depth_maps" / f"{name}.geometric.bin"


def normal_file(dense_dir: Path, name: str) -> Path:
    """Where its normal map lies."""
    return dense_dir / "stereo" / "normal_maps" / f"{name}.geometric.bin"


def read_planes(path: Path) -> Float32:
    """(C, H, W) float32 of a map in COLMAP's format, as `write_map` writes it; read from the disk when used. Raises
    `ProjectError`."""
    try:
        with path.open("rb") as handle:
            width, height, channels = (int(n) for n in handle.read(64).split(b"&")[:3])
        head = len(f"{width}&{height}&{channels}&")
        return np.memmap(path, np.dtype("<f4"), "r", head, (channels, height, width))
    except (OSError, ValueError) as error:
        raise ProjectError(
            f"{path}: cannot be read as a map of COLMAP's ({error})",
            hint="run the dense stage again with --from dense",
        ) from error


def read_depth(path: Path) -> Float32:
    """(H, W) float32, depth along the optical axis in world units, 0 for none. Raises `ProjectError`."""
    return np.asarray(read_planes(path)[0])


def write_map(values: Array, path: Path) -> None:
    """Writes (H, W) or (H, W, C) float32 in COLMAP's format of depth and normal maps, atomically.

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
    part.replace(path)


def _stop_file(dense_dir: Path) -> Path:
    return dense_dir / "stereo" / ".stop"
