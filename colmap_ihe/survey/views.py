"""Project points into the registered photographs of a model, and send rays out of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.observations import F64, Observation

_STEP = 1e-6  # of the distance, for derivatives


@dataclass(frozen=True, eq=False)
class View:
    """Hold the camera of one photograph, its pose (3, 4) `cam_from_world`, its centre (3,) in the frame of the model,
    and what it sees of one point: `seen_px` (2,), and the standard deviation of each coordinate."""

    image: str
    camera: pycolmap.Camera
    cam_from_world: F64
    centre: F64
    seen_px: F64
    accuracy_px: float

    def residuals(self, points: F64) -> F64:
        """Return (N, 2) in pixels: from where points (N, 3) project to where the point was seen; inf where they lie
        behind the camera."""
        return residuals_in_camera(self, points @ self.cam_from_world[:, :3].T + self.cam_from_world[:, 3])

    def derivatives(self, point: F64) -> F64:
        """Return (2, 3): how the residual of a point (3,) changes with it."""
        step = _STEP * float(np.linalg.norm(point - self.centre))
        moved = np.concatenate((point + step * np.eye(3), point - step * np.eye(3)))
        residuals = self.residuals(moved)
        return np.asarray((residuals[:3] - residuals[3:]).T / (2 * step))

    def ray(self) -> F64 | None:
        """Return (3,): the direction of length 1 in which the point was seen; None where the lens has none."""
        on_plane = self.camera.cam_from_img(self.seen_px)
        if on_plane is None or not np.isfinite(on_plane).all():
            return None
        direction = self.cam_from_world[:, :3].T @ np.append(on_plane, 1.0)
        return np.asarray(direction / np.linalg.norm(direction))


def view_of(model: pycolmap.Reconstruction, observation: Observation) -> View | None:
    """Return the photograph of an observation; None where the model has not registered it."""
    image = model.find_image_with_name(observation.image)
    if image is None or not image.has_pose:
        return None
    pose = np.asarray(image.cam_from_world().matrix())
    return View(
        image=observation.image,
        camera=model.cameras[image.camera_id],
        cam_from_world=pose,
        centre=np.asarray(image.projection_center()),
        seen_px=np.array((observation.x_px, observation.y_px)),
        accuracy_px=observation.accuracy_px,
    )


def residuals_in_camera(view: View, points: F64) -> F64:
    """Return (N, 2) in pixels, of points (N, 3) in the camera's frame; inf where they are not in front of it."""
    pixels = np.asarray(view.camera.img_from_cam(points))
    return np.where(np.isfinite(pixels), view.seen_px - pixels, np.inf)
