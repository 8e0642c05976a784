"""Hold one undistorted photograph with its camera, at any size.

OpenCV puts the centre of the top-left pixel at (0, 0), not at (0.5, 0.5): `cv_homography` is the one place where the
two meet for homographies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float64, PinholeCamera, UInt8


@dataclass(frozen=True)
class StereoView(PinholeCamera):
    """Hold a photograph with its camera.

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
        """Return the photograph at a smaller size; each pixel is the average over its area."""
        if size == self.size:
            return self
        camera = self.camera_resized(size)
        grey_u8 = np.asarray(cv2.resize(self.grey_u8, size, interpolation=cv2.INTER_AREA), np.uint8)
        mask_u8 = None
        if self.mask_u8 is not None:
            mask_u8 = np.asarray(cv2.resize(self.mask_u8, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        return StereoView(camera.K, camera.cam_from_world, size, grey_u8, mask_u8)


def cv_homography(homography: Float64) -> Float64:
    """Return the same (3, 3) pixel-to-pixel map with pixel centres on whole numbers, as OpenCV has them."""
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return np.asarray(np.linalg.inv(shift) @ homography @ shift)


def sizes_coarse_to_fine(size: tuple[int, int], coarsest: int) -> Sequence[tuple[int, int]]:
    """Return sizes that double up to `size`, from the first whose longer side is at most `coarsest`."""
    sizes = [size]
    while max(sizes[0]) > coarsest:
        sizes.insert(0, ((sizes[0][0] + 1) // 2, (sizes[0][1] + 1) // 2))
    return sizes
