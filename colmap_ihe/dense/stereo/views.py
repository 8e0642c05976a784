"""One undistorted photograph with its camera, as the stereo room sees it.

Pixel coordinates follow COLMAP everywhere in this package: the centre of the top-left pixel is at
(0.5, 0.5), so that a camera matrix scales with the image without an offset. OpenCV puts that centre
at (0, 0); `cv_homography` is the one place where the two meet for homographies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[Any]
Float32: TypeAlias = npt.NDArray[np.float32]
Float64: TypeAlias = npt.NDArray[np.float64]
UInt8: TypeAlias = npt.NDArray[np.uint8]
Bool: TypeAlias = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class StereoCamera:
    """A pinhole camera at its place: all that is needed to decide whether two photographs can be matched.

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
        """(3, 3): world directions to camera directions."""
        return self.cam_from_world[:, :3]

    @property
    def centre(self) -> Float64:
        """(3,): the projection centre in the world."""
        return np.asarray(-self.rotation.T @ self.cam_from_world[:, 3])

    def camera_resized(self, size: tuple[int, int]) -> StereoCamera:
        """The same camera with its image at another size."""
        scale = np.diag([size[0] / self.size[0], size[1] / self.size[1], 1.0])
        return StereoCamera(scale @ self.K, self.cam_from_world, size)

    def corners(self) -> Float64:
        """(4, 3): the outer corners of the image in homogeneous pixels."""
        width, height = self.size
        return np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], float)


@dataclass(frozen=True)
class StereoView(StereoCamera):
    """A photograph with its camera.

    `grey_u8` (H, W) uint8; `mask_u8` (H, W) uint8 or None, 0 where nothing may be matched. Raises
    ValueError where they do not have the camera's size.
    """

    grey_u8: UInt8
    mask_u8: UInt8 | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.size[::-1]
        if self.grey_u8.shape != shape or self.grey_u8.dtype != np.uint8:
            raise ValueError(f"{self.grey_u8.shape=} {self.grey_u8.dtype=}, expected {shape} uint8")
        if self.mask_u8 is not None and self.mask_u8.shape != shape:
            raise ValueError(f"{self.mask_u8.shape=}, expected {shape}")

    def resized(self, size: tuple[int, int]) -> StereoView:
        """The same photograph at a smaller size: each pixel is the average over its area."""
        if size == self.size:
            return self
        camera = self.camera_resized(size)
        grey_u8 = np.asarray(cv2.resize(self.grey_u8, size, interpolation=cv2.INTER_AREA), np.uint8)
        mask_u8 = None
        if self.mask_u8 is not None:
            mask_u8 = np.asarray(cv2.resize(self.mask_u8, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        return StereoView(camera.K, camera.cam_from_world, size, grey_u8, mask_u8)


def cv_homography(homography: Float64) -> Float64:
    """The same (3, 3) pixel-to-pixel map with pixel centres on whole numbers, as OpenCV has them."""
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return np.asarray(np.linalg.inv(shift) @ homography @ shift)


def sizes_coarse_to_fine(size: tuple[int, int], coarsest: int) -> Sequence[tuple[int, int]]:
    """Sizes that double up to `size`, from the first whose longer side is at most `coarsest`."""
    sizes = [size]
    while max(sizes[0]) > coarsest:
        sizes.insert(0, ((sizes[0][0] + 1) // 2, (sizes[0][1] + 1) // 2))
    return sizes
