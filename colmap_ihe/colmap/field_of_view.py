"""Tell what a camera of any model sees, and for which of its pixels the model says so.

A model is a formula for the picture that it was fitted to. Beyond, its polynomials turn back: points far aside would
project into the picture, onto others. And to a fisheye's pixels at 90 degrees and more from the axis COLMAP gives
directions that are not theirs. What leads back to where it came from is certain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

_F64 = NDArray[np.float64]

WIDEST_DEGREES = 80.0
"""From the axis, to which a flat picture goes at most: a degree is 33 times as long there as in its middle."""
_BACK_PX, _BACK_RADIANS = 0.5, 1e-3  # how near to itself what is certain comes back
_SIZES = np.linspace(1, 0.1, 46)  # of the box, that are tried
_ALONG = np.linspace(0, 1, 33)  # where on a side of the box


def pixels_of(camera: pycolmap.Camera, in_camera: NDArray[np.floating]) -> _F64:
    """Return (N, 2): where the camera sees points (N, 3) of its frame, in pixels; nan where it does not, as where its
    model folds a point back into the picture."""
    points = np.asarray(in_camera, np.float64).reshape(-1, 3)
    pixels = np.array(camera.img_from_cam(points), np.float64).reshape(-1, 2)
    inside = ((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(axis=1)  # nan is in no picture
    rows = np.flatnonzero(inside)
    rays = np.asarray(camera.cam_ray_from_img(pixels[rows])).reshape(-1, 3)
    directions = points[rows] / np.linalg.norm(points[rows], axis=1, keepdims=True)
    seen = rows[np.linalg.norm(rays - directions, axis=1) < _BACK_RADIANS]
    unseen = np.ones(len(pixels), bool)
    unseen[seen] = False
    pixels[unseen] = np.nan
    return pixels


def certain(camera: pycolmap.Camera, pixels: _F64) -> NDArray[np.bool_]:
    """Return (N,), true for pixels (N, 2) whose ray is within `WIDEST_DEGREES` of the axis and leads back to them."""
    rays = np.array(camera.cam_ray_from_img(pixels), np.float64).reshape(-1, 3)
    within = rays[:, 2] > np.cos(np.radians(WIDEST_DEGREES))  # nan is not
    rays[~within] = (0, 0, 1)
    back = np.asarray(camera.img_from_cam(rays)).reshape(-1, 2)
    return np.asarray(within & (np.abs(back - pixels) < _BACK_PX).all(axis=1))


def certain_box(camera: pycolmap.Camera) -> _F64:
    """Return left, top, right and bottom, in pixels, of the part of its picture that a camera sees within
    `WIDEST_DEGREES` of its axis and is certain of: all but of the widest fisheyes and of models that turn back; nan for
    nothing. The part is about the principal point, as far as the picture goes. Of a panorama it is all."""
    size = np.array([camera.width, camera.height], np.float64)
    if camera.is_spherical():  # COLMAP dies when asked for its principal point
        return np.array([0, 0, *size])
    middle = np.array([camera.principal_point_x, camera.principal_point_y])
    reach = np.maximum(middle, size - middle)
    for share in _SIZES:
        low, high = np.maximum(middle - share * reach, 0), np.minimum(middle + share * reach, size)
        box = np.concatenate([low, high]).round(6)  # whole numbers where it is the whole picture
        if certain(camera, _border(box)).all():
            return np.asarray(box, np.float64)
    return np.full(4, np.nan)


def _border(box: _F64) -> _F64:
    """Return (N, 2), pixels along the sides of a box, corners among them."""
    low, high = box[:2], box[2:]
    first, last = np.zeros_like(_ALONG), np.ones_like(_ALONG)
    x, y = np.concatenate([_ALONG, last, _ALONG, first]), np.concatenate([first, _ALONG, last, _ALONG])
    return np.asarray(low + np.stack([x, y], axis=1) * (high - low))
