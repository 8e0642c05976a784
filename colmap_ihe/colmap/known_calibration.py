"""Let cameras in COLMAP's database start from a calibration that is known, by what EXIF and size say of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from colmap_ihe.colmap.calibration_file import CalibratedCamera, in_words
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.photographs.camera_identity import CameraIdentity, identities_of_cameras


@dataclass(frozen=True)
class KnownCalibration:
    """Hold the cameras that can start from a calibration, and what each image says of its camera, by name."""

    cameras: Sequence[CalibratedCamera] = ()
    identities: Mapping[str, CameraIdentity] = field(default_factory=dict)


@dataclass(frozen=True)
class CalibrationUse:
    """Hold what a calibration was good for: ids of the cameras that start from it, names of the images whose cameras do
    not, and in words those of its cameras that took no image."""

    camera_ids: tuple[int, ...] = ()
    without: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()


def calibration_for(identity: CameraIdentity, cameras: Sequence[CalibratedCamera]) -> CalibratedCamera | None:
    """Return the calibration of the camera that took a photograph, None where there is none.

    Where all photographs were made smaller or larger, that of another size with the same shape does, to a pixel; not
    where EXIF does not name the camera, as sizes alone are no evidence.
    """
    alike = [camera for camera in cameras if camera.identity.optics == identity.optics]
    same = [camera for camera in alike if camera.identity.size == identity.size]
    if same:
        return same[0]
    scaled = [camera for camera in alike if identity.is_whole and _has_shape_of(camera, identity)]
    return max(scaled, key=lambda camera: camera.width, default=None)


def _has_shape_of(camera: CalibratedCamera, identity: CameraIdentity) -> bool:
    scaled_height = camera.height * identity.width / camera.width
    scaled_width = camera.width * identity.height / camera.height
    return abs(scaled_height - identity.height) <= 1 or abs(scaled_width - identity.width) <= 1


def start_cameras(database: Path, known: KnownCalibration) -> None:
    """Let each camera of a database start from its calibration, rescaled to its size."""
    with pycolmap.Database.open(database) as opened:
        for camera_id, calibrated in _by_camera_id(opened, known).items():
            camera = opened.read_camera(camera_id)
            opened.update_camera(_started(camera, calibrated))


def _started(camera: pycolmap.Camera, calibrated: CalibratedCamera) -> pycolmap.Camera:
    started = pycolmap.Camera(
        camera_id=camera.camera_id,
        model=calibrated.camera_model,
        width=calibrated.width,
        height=calibrated.height,
        params=calibrated.params,
    )
    if (camera.width, camera.height) != (calibrated.width, calibrated.height):
        started.rescale(camera.width, camera.height)
    started.has_prior_focal_length = True
    return started


def use_of(database: Path, known: KnownCalibration) -> CalibrationUse:
    """Return what the calibration is good for in a database; nothing where none is known."""
    if not known.cameras:
        return CalibrationUse()
    with pycolmap.Database.open(database) as opened:
        started = _by_camera_id(opened, known)
        images = opened.read_all_images()
    without = sorted(str(image.name) for image in images if image.camera_id not in started)
    unused = [in_words(c.identity) for c in known.cameras if c not in started.values()]
    return CalibrationUse(tuple(sorted(started)), tuple(without), tuple(unused))


def _by_camera_id(database: pycolmap.Database, known: KnownCalibration) -> dict[int, CalibratedCamera]:
    """Return the calibration of each camera that has one. A camera that took photographs which say different things of
    it, as with `camera.mode: single`, has none."""
    camera_ids = {str(image.name): int(image.camera_id) for image in database.read_all_images()}
    started = {}
    for camera_id, identity in identities_of_cameras(camera_ids, known.identities).items():
        calibrated = calibration_for(identity, known.cameras)
        if calibrated is not None:
            started[camera_id] = calibrated
    return started
