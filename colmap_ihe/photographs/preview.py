"""A small picture of a photograph, quickly: to see what it shows, not to measure in it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.photographs.decode import message_of, read_photograph_here, read_size_here
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.raw.develop import half_size

_FULL = 99.5
"""Per cent of the values of a linear picture that are not clipped."""


def small_picture(capture: Capture, side: int) -> NDArray[np.uint8]:
    """As `small_picture_here`, by a decoder in a process of its own."""
    message = message_of(capture)
    _, picture = decoders.ask("small", capture.name, capture.pixels, capture=message, side=side)
    if picture is None:
        raise PhotographError(f"{capture.name}: the decoder returned no pixels")
    with decoders.understood(capture.name):
        if picture.dtype != np.uint8 or picture.shape[2:] != (3,):
            raise ValueError(f"{picture.dtype} pixels of {picture.shape}")
    return np.asarray(picture, np.uint8)


def small_picture_here(capture: Capture, side: int) -> NDArray[np.uint8]:
    """The photograph, its longer side `side` pixels or less: (H, W, 3) uint8, gamma-coded as stored, turned as
    stored; of a RAW file sensor colours, coded by a square root. Raises `PhotographError`, though not for
    all that `read_photograph` would refuse.
    """
    read_size_here(capture)
    if capture.kind == "raw":
        linear = _shrunk(half_size(capture.path), side).astype(np.float32)
        white = max(1.0, float(np.percentile(linear, _FULL)))
        return np.asarray(255 * np.sqrt(np.minimum(linear / white, 1)) + 0.5, np.uint8)
    rgb = _scaled_jpeg(capture.path, side)
    if rgb is None:
        rgb = np.asarray(read_photograph_here(capture).rgb, np.uint8)
    return np.asarray(_shrunk(rgb, side), np.uint8)


def _scaled_jpeg(path: Path, side: int) -> NDArray[np.uint8] | None:
    """A JPEG decoded at an eighth of its size or more, none of its sides below `side` if it need not; None for
    another kind of file, or a JPEG that libjpeg has a word to say of."""
    if path.suffix.lower() not in (".jpg", ".jpeg", ".jpe"):
        return None
    try:
        data = path.read_bytes()
        height, width, colours, _ = simplejpeg.decode_jpeg_header(data)
        if colours == "CMYK":
            return None
        least = {"min_width": side} if width >= height else {"min_height": side}
        return np.asarray(simplejpeg.decode_jpeg(data, "RGB", strict=True, **least))
    except (OSError, ValueError):
        return None


def _shrunk(rgb: NDArray[np.uint8] | NDArray[np.uint16], side: int) -> NDArray[np.generic]:
    height, width = rgb.shape[:2]
    factor = side / max(height, width)
    if factor >= 1:
        return rgb
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
