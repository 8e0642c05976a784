"""Choose what of a photograph COLMAP can lay flat, and hand it that.

COLMAP's undistortion leaves two things to its caller. A camera whose coefficients are all zero counts as undistorted,
a fisheye too, and keeps its model and its photographs as they are. And where a model is not certain of the corners
(`colmap.field_of_view`), the size that COLMAP chooses by them means nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.field_of_view import certain_box
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Float64, UInt8
from colmap_ihe.errors import MappingError

_NOT_ZERO = 1.1e-8  # COLMAP takes coefficients up to 1e-8 for zero


@dataclass(frozen=True)
class FlatPart:
    """Describe the part of a photograph that can be laid flat: its first column and row, the camera of the part alone,
    and the share of the photograph's pixels that it has."""

    left: int
    top: int
    camera: pycolmap.Camera
    share: float

    @property
    def is_whole(self) -> bool:
        """Return whether the part is all of the photograph."""
        return self.share == 1

    def of(self, photograph: UInt8) -> UInt8:
        """Return the part, (h, w) or (h, w, 3), of a photograph (H, W) or (H, W, 3)."""
        rows = slice(self.top, self.top + self.camera.height)
        return np.ascontiguousarray(photograph[rows, self.left : self.left + self.camera.width])


def flat_part(camera: pycolmap.Camera) -> FlatPart:
    """Return the part of the photographs of a camera that can be laid flat. Raises `MappingError` where there is none,
    as of a panorama."""
    box = certain_box(camera)
    if camera.is_spherical() or np.isnan(box).any():
        raise MappingError(
            f"camera {camera.camera_id} of the model, {camera.model_name} {np.round(camera.params, 4).tolist()}, sees"
            " nothing that could be laid flat",
            hint="make the model with another camera.model, or add --no-dense",
        )
    left, top = (int(side) for side in np.ceil(box[:2]))
    right, bottom = (int(side) for side in np.floor(box[2:]))
    part = _counted_as_it_is(camera)
    part.width, part.height = right - left, bottom - top
    part.principal_point_x -= left
    part.principal_point_y -= top
    share = part.width * part.height / (camera.width * camera.height)
    return FlatPart(left, top, part, share)


def _counted_as_it_is(camera: pycolmap.Camera) -> pycolmap.Camera:
    """Return a copy of the camera that COLMAP treats as what it is: a pinhole, or one with distortion."""
    copy = pycolmap.Camera(camera.todict())
    if camera.is_undistorted():
        pinhole = [camera.focal_length_x, camera.focal_length_y]
        pinhole += [camera.principal_point_x, camera.principal_point_y]
        copy.model, copy.params = pycolmap.CameraModelId.PINHOLE, pinhole
        if camera.is_perspective_fisheye():
            copy.model = pycolmap.CameraModelId.OPENCV_FISHEYE
            copy.params = [*pinhole, _NOT_ZERO, 0.0, 0.0, 0.0]
    return copy


def write_flat_model(
    model: pycolmap.Reconstruction,
    parts: Mapping[int, FlatPart],
    options: pycolmap.UndistortCameraOptions,
    folder: Path,
) -> None:
    """Write a model as it is of photographs laid flat, of which only the `parts` are there, by the ids of their
    cameras."""
    flat_model = pycolmap.Reconstruction(model)
    flat = {number: pycolmap.undistort_camera(options, part.camera) for number, part in parts.items()}
    for image_id in flat_model.reg_image_ids():
        image = flat_model.images[image_id]
        part = parts[image.camera_id]
        places = np.array([point.xy for point in image.points2D]).reshape(-1, 2) - (part.left, part.top)
        moved = _moved(places, part.camera, flat[image.camera_id])
        for point, place in zip(image.points2D, moved, strict=True):
            point.xy = place
    for number, camera in flat.items():
        target = flat_model.cameras[number]
        target.model, target.params = camera.model, list(camera.params)
        target.width, target.height = camera.width, camera.height
    folder.mkdir(parents=True, exist_ok=True)
    flat_model.write(folder)


def _moved(places: Float64, camera: pycolmap.Camera, flat: pycolmap.Camera) -> Float64:
    """Return (N, 2), where the pixels `places` (N, 2) of a camera are on the flat picture; those without a ray stay."""
    rays = np.asarray(camera.cam_from_img(places), np.float64)
    moved = np.asarray(flat.img_from_cam(np.column_stack([rays, np.ones(len(places))])), np.float64)
    return np.where(np.isfinite(moved), moved, places)
