"""Define the pinhole camera, and names for the array types, of the dense stages.

Pixels are COLMAP's everywhere: the centre of the top-left pixel is at (0.5, 0.5), so a camera matrix scales with the
image without an offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[Any]
Float32: TypeAlias = npt.NDArray[np.float32]
Float64: TypeAlias = npt.NDArray[np.float64]
Int32: TypeAlias = npt.NDArray[np.int32]
Int64: TypeAlias = npt.NDArray[np.int64]
UInt8: TypeAlias = npt.NDArray[np.uint8]
Bool: TypeAlias = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class PinholeCamera:
    """Describe the camera of an undistorted photograph.

    `K` (3, 3) float64 in pixels; `cam_from_world` (3, 4) float64; `size` width and height in pixels.
    Raises ValueError on other shapes.
    """

    K: Float64
    cam_from_world: Float64
    size: tuple[int, int]

    def __post_init__(self) -> None:
        if self.K.shape != (3, 3) or self.cam_from_world.shape != (3, 4):
            raise ValueError(f"{self.K.shape=} {self.cam_from_world.shape=}, expected (3, 3) and (3, 4)")

    @property
    def rotation(self) -> Float64:
        """Return (3, 3), which turns world directions to camera directions."""
        return self.cam_from_world[:, :3]

    @property
    def centre(self) -> Float64:
        """Return (3,), the projection centre in the world."""
        return np.asarray(-self.rotation.T @ self.cam_from_world[:, 3])

    def camera_resized(self, size: tuple[int, int]) -> PinholeCamera:
        """Return the same camera with its image at another size."""
        scale = np.diag([size[0] / self.size[0], size[1] / self.size[1], 1.0])
        return PinholeCamera(scale @ self.K, self.cam_from_world, size)

    def corners(self) -> Float64:
        """Return (4, 3), the outer corners of the image in homogeneous pixels."""
        width, height = self.size
        return np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], float)

    def project(self, points: Float32) -> tuple[Float64, Float64]:
        """Return the pixels (..., 2) of world points (..., 3) and their depths (...) along the optical axis.

        Pixels are nan where the depth is not positive.
        """
        in_camera = points.astype(np.float64) @ self.rotation.T + self.cam_from_world[:, 3]
        depth = in_camera[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (in_camera @ self.K.T)[..., :2] / depth[..., None]
        return np.where((depth > 0)[..., None], pixels, np.nan), depth

    def homogeneous(self, points: Float32) -> Float64:
        """Return (..., 3), world points (..., 3) as pixels times depth, and depth along the optical axis."""
        turned = points.astype(np.float64) @ (self.K @ self.rotation).T
        return np.asarray(turned + self.K @ self.cam_from_world[:, 3])
