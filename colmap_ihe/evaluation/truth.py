"""Read where the cameras really were and what they saw, and tell how far a reconstruction is from that.

Poses are (3, 4) float64 `cam_from_world`, camera x right, y down, z forward. Pixels
are COLMAP's: the centre of the top left pixel is (0.5, 0.5). Images go by name without suffix
(`key_of`), because the pictures a project works on have another suffix than the photographs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import numpy.typing as npt
from PIL import Image

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.files import is_readable_name, open_file, read_at_most

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

_MOST_BYTES = 1 << 26  # of cameras.json: some 50,000 cameras
_MOST_NUMBERS = 4096  # bytes of a .camera file, which holds 26
_LONGEST = 100_000  # pixels of a side


@dataclass(frozen=True)
class TrueImage:
    """Describe one photograph: `calibration` K (3, 3), `cam_from_world` (3, 4) in metres; `depth_file` as in `depth_m`,
    None where no depth is known."""

    width: int
    height: int
    calibration: F64
    cam_from_world: F64
    depth_file: Path | None = None
    nearest_m: float = 1.0

    def depth_m(self) -> F32:
        """Read (height, width) float32: metres along the optical axis at pixel centres, 0 where nothing is. Raises
        ValueError where no depth is known, `ProjectError` for a file that is not of this image."""
        if self.depth_file is None:
            raise ValueError("no true depth is known of this image")
        try:
            with open_file(self.depth_file) as file, Image.open(file, formats=("PNG",)) as picture:
                if picture.size != (self.width, self.height) or not picture.mode.startswith("I"):
                    raise ValueError(f"{picture.size} pixels of kind {picture.mode}, expected 16-bit grey")
                code = np.asarray(picture).astype(np.float32)
        except (OSError, ValueError, SyntaxError, MemoryError, Image.DecompressionBombError) as error:
            raise ProjectError(
                f"{self.depth_file}: not the true depth of {self.width}x{self.height} pixels ({error})",
                hint="render the truth again",
            ) from error
        depth = np.zeros(code.shape, np.float32)
        np.divide(np.float32(65535 * self.nearest_m), code, out=depth, where=code > 0)
        return depth


@dataclass(frozen=True)
class Truth:
    """Hold the true images by key, and the extent of the scene in metres that errors are compared with."""

    images: Mapping[str, TrueImage]
    extent_m: float


def key_of(name: str) -> str:
    """Return an image's name, relative to its folder, without its suffix."""
    return PurePosixPath(name).with_suffix("").as_posix()


def read_truth(folder: Path) -> Truth:
    """Read `cameras.json` of the demo or Strecha's `NAME.camera` files, whichever `folder` holds. Raises `ProjectError`
    where there is neither, and where it cannot be read."""
    cameras = sorted(folder.glob("*.camera"))
    try:
        if (folder / "cameras.json").is_file():
            return _read_demo(folder / "cameras.json")
        if cameras:
            return _read_strecha(cameras)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ProjectError(
            f"{folder} holds truth that cannot be read: {error!r:.300}", "correct it, or move it away"
        ) from error
    raise ProjectError(f"{folder} holds no truth", "it should hold cameras.json or NAME.camera files")


def _read_demo(file: Path) -> Truth:
    """Read `cameras.json`, documented in `colmap_ihe.evaluation.demo.render`."""
    record = json.loads(read_at_most(file, _MOST_BYTES).decode("utf-8"))
    images = {
        str(key): TrueImage(
            *_sides(camera["width"], camera["height"]),
            calibration=_matrix(camera["calibration"], (3, 3)),
            cam_from_world=_matrix(camera["cam_from_world"], (3, 4)),
            depth_file=_beside(file, camera["depth"]),
            nearest_m=_positive(camera["nearest_m"]),
        )
        for key, camera in record["cameras"].items()
    }
    return Truth(images, _positive(record["extent_m"]))


def _sides(width: object, height: object) -> tuple[int, int]:
    if isinstance(width, int) and isinstance(height, int) and all(0 < n <= _LONGEST for n in (width, height)):
        return width, height
    raise ValueError(f"{width!r:.20}x{height!r:.20} pixels")


def _matrix(values: object, shape: tuple[int, int]) -> F64:
    matrix = np.array(values, np.float64)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise ValueError(f"{matrix.shape} numbers, expected {shape}, all finite")
    return matrix


def _positive(value: object) -> float:
    if type(value) not in (int, float) or not 0 < float(value) < float("inf"):  # type: ignore[arg-type]
        raise ValueError(f"{value!r:.40}, expected a positive number")
    return float(value)  # type: ignore[arg-type]


def _beside(file: Path, name: str) -> Path:
    """Return the file of that name in the folder of `file`. Raises ValueError for a name that leads elsewhere."""
    path = file.parent / name
    plain = name and Path(name).name == name and is_readable_name(name)
    if not plain or not path.resolve().is_relative_to(file.parent.resolve()):
        raise ValueError(f"{name!r:.80} is not a file beside {file.name}")
    return path


def _read_strecha(files: Sequence[Path]) -> Truth:
    """Read Strecha et al. 2008, one file an image: K, three zeros, R camera to world, centre, width height.

    There K has the centre of the top left pixel at (0, 0). The files do not say how large the scene is:
    the extent is the diagonal of the box around the cameras.
    """
    images, centres = {}, []
    for file in files:
        numbers = np.array(read_at_most(file, _MOST_NUMBERS).split(), np.float64)
        if not np.isfinite(numbers).all():
            raise ValueError(f"{file} holds numbers that are not finite")
        if numbers.size != 26:
            raise ValueError(f"{file} holds {numbers.size} numbers, expected 26")
        calibration = numbers[:9].reshape(3, 3)
        calibration[:2, 2] += 0.5
        world_from_cam, centre = numbers[12:21].reshape(3, 3), numbers[21:24]
        pose = np.hstack((world_from_cam.T, -(world_from_cam.T @ centre)[:, None]))
        width, height = _sides(*(int(n) for n in numbers[24:]))
        images[key_of(file.name.removesuffix(".camera"))] = TrueImage(width, height, calibration, pose)
        centres.append(centre)
    return Truth(images, float(np.linalg.norm(np.ptp(centres, axis=0))))


@dataclass(frozen=True)
class Similarity:
    """Describe `to = scale * rotation @ from + translation`: (3, 3) and (3,) float64."""

    scale: float
    rotation: F64
    translation: F64


def align_similarity(points_from: F64, points_to: F64) -> Similarity:
    """Return the similarity that takes (N, 3) points nearest to (N, 3) others by least squares.

    Raises ValueError for fewer than three points, or all on one line. Closed form of Umeyama 1991 over all points;
    pycolmap estimates robustly from samples, which would hide bad cameras.
    """
    if points_from.shape != points_to.shape or points_from.ndim != 2 or points_from.shape[1] != 3:
        raise ValueError(f"{points_from.shape=}, {points_to.shape=}, expected (N, 3) twice")
    mean_from, mean_to = points_from.mean(axis=0), points_to.mean(axis=0)
    centred_from, centred_to = points_from - mean_from, points_to - mean_to
    u, spread, vt = np.linalg.svd(centred_to.T @ centred_from)
    if len(points_from) < 3 or spread[1] <= 1e-12 * max(spread[0], 1e-300):
        raise ValueError(f"{len(points_from)} points on one line do not fix a similarity")
    sign = np.array((1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))))
    rotation = (u * sign) @ vt
    scale = float((spread * sign).sum() / (centred_from**2).sum())
    return Similarity(scale, rotation, mean_to - scale * rotation @ mean_from)


@dataclass(frozen=True)
class PoseErrors:
    """Hold the errors of registered images by key, after the best similarity; `missing` were not registered."""

    rotation_deg: Mapping[str, float]
    position_m: Mapping[str, float]
    position_percent: Mapping[str, float]
    missing: tuple[str, ...]
    world_from_model: Similarity

    @property
    def rotation_error_deg(self) -> float:
        """Return the mean over the registered images."""
        return float(np.mean(list(self.rotation_deg.values())))

    @property
    def position_error_m(self) -> float:
        """Return the mean over the registered images."""
        return float(np.mean(list(self.position_m.values())))

    @property
    def position_error_percent(self) -> float:
        """Return the mean over the registered images, in percent of the extent of the scene."""
        return float(np.mean(list(self.position_percent.values())))


def pose_errors(cam_from_world: Mapping[str, F64], truth: Truth) -> PoseErrors:
    """Return how far estimated poses, (3, 4) by image name with or without suffix, are from the truth.

    The model's frame is aligned to the truth by the projection centres alone. Raises `ProjectError`
    where fewer than three images are known to both, or all lie on one line.
    """
    poses = {key_of(n) if key_of(n) in truth.images else n: pose for n, pose in cam_from_world.items()}
    keys = sorted(poses.keys() & truth.images.keys())
    true = {key: truth.images[key].cam_from_world for key in keys}
    try:
        similarity = align_similarity(
            np.array([_centre(poses[k]) for k in keys]).reshape(-1, 3),
            np.array([_centre(true[k]) for k in keys]).reshape(-1, 3),
        )
    except ValueError as error:
        who = f"{len(keys)} registered images"
        raise ProjectError(f"{who} cannot be compared with the truth: {error}") from error
    rotation, position = {}, {}
    for key in keys:
        turned = poses[key][:, :3] @ similarity.rotation.T
        rotation[key] = _angle_deg(turned @ true[key][:, :3].T)
        moved = similarity.scale * similarity.rotation @ _centre(poses[key]) + similarity.translation
        position[key] = float(np.linalg.norm(moved - _centre(true[key])))
    percent = {key: 100 * error / truth.extent_m for key, error in position.items()}
    missing = tuple(sorted(truth.images.keys() - poses.keys()))
    return PoseErrors(rotation, position, percent, missing, similarity)


def _centre(cam_from_world: F64) -> F64:
    return np.asarray(-cam_from_world[:, :3].T @ cam_from_world[:, 3])


def _angle_deg(rotation: F64) -> float:
    """Return the angle of a rotation; by the sine too, since the cosine alone cannot tell angles below 1e-6."""
    sine = np.linalg.norm((rotation - rotation.T)[[0, 0, 1], [1, 2, 2]]) / 2
    return float(np.degrees(np.arctan2(sine, (np.trace(rotation) - 1) / 2)))
