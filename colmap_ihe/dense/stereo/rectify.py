"""Rectify a pair: find a frame in which a point lies on the same row of both images.

The frame is turned along the baseline (Fusiello, Trucco and Verri 2000, "A compact algorithm for
rectification of stereo pairs"), whatever its direction, so that vertical baselines and rolled cameras
need no special case: both images are simply sampled through a rotation. The source is always on the
positive x side, so disparities are positive. The frame is as big as the overlap needs and its focal
length keeps the resolution of the reference, so nothing is cropped.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.camera import Array, Bool, Float32, Float64, PinholeCamera
from colmap_ihe.dense.stereo.views import StereoView, cv_homography

MIN_AXIS_ANGLE_DEG = 30.0
MAX_AREA_RATIO = 3.0
MIN_OVERLAP = 0.05


class PairLeftOutError(Exception):
    """Tell that a pair cannot be matched in a common plane; `str(error)` is the reason."""


@dataclass(frozen=True)
class RectifiedPair:
    """Describe the common frame of a reference and a source.

    `from_reference` and `from_source` (3, 3) map homogeneous pixels to rectified pixels, whose origin
    is the principal point; `left`, `top`, `width`, `height` is the part of the rectified plane that
    holds the overlap as the reference sees it; `focal_px` the focal length; `baseline` in world units;
    `disparities` the smallest and largest one expected, in rectified pixels; `depth_row` (3,): the
    depth in the reference of a point at rectified pixel q and rectified depth z is z times `depth_row @
    q`.
    """

    from_reference: Float64
    from_source: Float64
    left: int
    top: int
    width: int
    height: int
    focal_px: float
    baseline: float
    disparities: tuple[float, float]
    depth_row: Float64

    def reference_in_frame(self, image: Array, pad: int) -> Array:
        """Return `image` (H, W) of the reference in the frame: (height, width + 2 pad), 0 outside."""
        return self._in_frame(image, self.from_reference, self.left - pad, pad)

    def source_in_frame(self, image: Array, pad: int, shift: int) -> Array:
        """Return `image` (H, W) of the source in the frame, moved right by `shift` pixels; 0 outside."""
        return self._in_frame(image, self.from_source, self.left - pad - shift, pad)

    def _in_frame(self, image: Array, homography: Float64, left: int, pad: int) -> Array:
        size = (self.width + 2 * pad, self.height)
        return np.asarray(cv2.warpPerspective(image, self._cv_map(homography, left), size))

    def _cv_map(self, homography: Float64, left: int) -> Float64:
        """Return `homography` to a frame whose top left is (`left`, `top`), for OpenCV."""
        return cv_homography(np.array([[1, 0, -left], [0, 1, -self.top], [0, 0, 1.0]]) @ homography)

    def disparity_per_inverse_depth(self, pad: int = 0) -> Float32:
        """Return (height, width + 2 pad) float32: disparity in pixels at inverse depth 1 in the reference."""
        u = np.arange(self.width + 2 * pad) + (self.left - pad + 0.5)
        v = np.arange(self.height) + (self.top + 0.5)
        row = self.depth_row * self.focal_px * self.baseline
        return np.asarray(row[0] * u[None, :] + (row[1] * v[:, None] + row[2]), np.float32)

    def source_pixels(self, disparity: Float32, pad: int = 0) -> tuple[Float32, Float32]:
        """Return x and y, for cv2.remap, at which the source sees rectified pixel (u - disparity, v)."""
        inverse = np.linalg.inv(self.from_source)
        u = (np.arange(disparity.shape[1]) + (self.left - pad + 0.5)).astype(np.float32)[None, :] - disparity
        v = np.arange(self.height)[:, None] + (self.top + 0.5)
        rows = [np.float32(row[0]) * u + (row[1] * v + row[2]).astype(np.float32) for row in inverse]
        return rows[0] / rows[2] - np.float32(0.5), rows[1] / rows[2] - np.float32(0.5)

    def to_reference(self, inverse_depth: Float32, size: tuple[int, int]) -> Float32:
        """Return `inverse_depth` (height, width), 0 for none, resampled to the reference's pixels, `size` (W, H).

        Where some neighbours have no depth the others are averaged, if they carry more than half the weight.
        """
        moved = self._cv_map(self.from_reference, self.left)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        weight = cv2.warpPerspective((inverse_depth > 0).astype(np.float32), moved, size, flags=flags)
        total = cv2.warpPerspective(inverse_depth, moved, size, flags=flags)
        return np.where(weight > 0.5, total / np.maximum(weight, 0.5), 0).astype(np.float32)


def rectify(reference: PinholeCamera, source: PinholeCamera, points_world: Float64) -> RectifiedPair:
    """Return the common frame of two views that both see `points_world` (N, 3), N >= 1.

    Raises PairLeftOutError, with the reason, where no plane suits both views: the baseline is within
    `MIN_AXIS_ANGLE_DEG` of a viewing direction, the frame would be more than `MAX_AREA_RATIO` times the
    reference, or the views hardly overlap.
    """
    baseline, rotation = _rotation(reference, source)
    source_rotation = rotation @ reference.rotation @ source.rotation.T
    reference_plane = rotation @ np.linalg.inv(reference.K)
    source_plane = source_rotation @ np.linalg.inv(source.K)
    for plane, view in ((reference_plane, reference), (source_plane, source)):
        if ((view.corners() @ plane.T)[:, 2] < 0.1).any():
            raise PairLeftOutError("a view looks away from the common plane by more than it can hold")
    focal_px = 1.0 / _scale_at_centre(reference_plane, reference)
    to_pixels = np.diag([focal_px, focal_px, 1.0])
    from_reference, from_source = to_pixels @ reference_plane, to_pixels @ source_plane
    points = (points_world - reference.centre) @ (rotation @ reference.rotation).T
    depth = points[:, 2][points[:, 2] > 0]
    if not depth.size:
        raise PairLeftOutError("no sparse point lies in front of both views")
    low, high = np.percentile(focal_px * baseline / depth, [1, 99.7])
    margin = 0.25 * (high - low) + 4.0  # for depths without sparse points
    disparities = max(0.0, float(low - margin)), float(high + margin)
    left, top, width, height = _overlap(reference, source, from_reference, from_source, disparities)
    depth_row = rotation[:, 2] @ np.linalg.inv(to_pixels)
    return RectifiedPair(
        from_reference, from_source, left, top, width, height, focal_px, baseline, disparities, depth_row
    )


def inside(x: Float32, y: Float32, view: StereoView) -> Bool:
    """Tell which OpenCV pixel positions lie on the view's image and are not masked out."""
    width, height = view.size
    held = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    if view.mask_u8 is not None:
        held &= cv2.remap(view.mask_u8, x, y, cv2.INTER_NEAREST) > 0
    return np.asarray(held)


def _rotation(reference: PinholeCamera, source: PinholeCamera) -> tuple[float, Float64]:
    """Return the length of the baseline, and the rotation from the reference's camera to the rectified frame."""
    offset = reference.rotation @ (source.centre - reference.centre)
    baseline = float(np.linalg.norm(offset))
    if baseline == 0:
        raise PairLeftOutError("both views were taken from the same place")
    x = offset / baseline
    axes = np.array([[0.0, 0.0, 1.0], (reference.rotation @ source.rotation.T)[:, 2]])
    angle = float(np.degrees(np.arccos(np.abs(axes @ x).max())))
    if angle < MIN_AXIS_ANGLE_DEG:
        raise PairLeftOutError(
            f"the baseline is {angle:.0f} degrees from a viewing direction, under {MIN_AXIS_ANGLE_DEG:.0f}"
        )
    z = axes.sum(axis=0)
    z -= (z @ x) * x
    if np.linalg.norm(z) < 0.5:
        raise PairLeftOutError("the views look in opposite directions")
    z /= np.linalg.norm(z)
    return baseline, np.array([x, np.cross(z, x), z])


def _scale_at_centre(plane_from_pixels: Float64, view: PinholeCamera) -> float:
    """Return the square root of the area that the view's central pixel covers on the plane z = 1."""
    width, height = view.size
    centre = np.array([width / 2, height / 2, 1.0])
    corners = (centre + np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])) @ plane_from_pixels.T
    flat = corners[:, :2] / corners[:, 2:]
    (ax, ay), (bx, by) = flat[1] - flat[0], flat[2] - flat[0]
    return float(np.sqrt(abs(ax * by - ay * bx)))


def _overlap(
    reference: PinholeCamera,
    source: PinholeCamera,
    from_reference: Float64,
    from_source: Float64,
    disparities: tuple[float, float],
) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the part that the reference can share with the source."""
    boxes = []
    for view, homography in ((reference, from_reference), (source, from_source)):
        corners = view.corners() @ homography.T
        flat = corners[:, :2] / corners[:, 2:]
        boxes.append((flat.min(axis=0), flat.max(axis=0)))
    (ref_low, ref_high), (src_low, src_high) = boxes
    low = np.maximum(ref_low, src_low + np.array([disparities[0], 0]))
    high = np.minimum(ref_high, src_high + np.array([disparities[1], 0]))
    left, top = np.floor(low).astype(int)
    width, height = np.ceil(high).astype(int) - (left, top)
    area = reference.size[0] * reference.size[1]
    if min(width, height) <= 0 or width * height < MIN_OVERLAP * area:
        raise PairLeftOutError(f"the views overlap in less than {MIN_OVERLAP:.0%} of the reference")
    if width * height > MAX_AREA_RATIO * area:
        raise PairLeftOutError(f"the common frame would be {width * height / area:.1f} times the reference")
    return int(left), int(top), int(width), int(height)
