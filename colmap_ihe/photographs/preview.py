"""Small pictures of photographs, quickly: to see what they show, not to measure in them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from colmap_ihe.machine.decoder_pool import in_decoder
from colmap_ihe.machine.decoder_process import nonsense
from colmap_ihe.photographs.decode import decode_photograph, decode_size
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.raw.develop import half_size
from colmap_ihe.photographs.raw.undecoded import refuse_damaged

_FULL = 99.5
"""Per cent of the values of a linear picture that are not clipped."""


def small_picture(capture: Capture, side: int) -> NDArray[np.uint8]:
    """Return the photograph, its longer side `side` pixels or less: (H, W, 3) uint8, gamma-coded as stored, turned as
    stored; of a RAW file sensor colours, coded by a square root. Raises `PhotographError`, though not for
    all that `read_photograph` would refuse.
    """
    picture = in_decoder(decode_small, capture, side, pixels=capture.pixels)
    if picture.shape[2:] != (3,):
        raise nonsense(capture.name, f"{picture.shape=}")
    return picture


def decode_small(capture: Capture, side: int) -> NDArray[np.uint8]:
    """Return what `small_picture` does, in this process."""
    decode_size(capture)
    if capture.kind == "raw":
        linear = _shrunk(half_size(capture.path), side)
        refuse_damaged(capture.name)
        return _square_root(linear)
    rgb = _scaled_jpeg(capture.path, side)
    if rgb is None:
        rgb = _coded(decode_photograph(capture).rgb)
    return np.asarray(_shrunk(rgb, side), np.uint8)


def _coded(rgb: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    return _square_root(rgb) if rgb.dtype == np.uint16 else np.asarray(rgb, np.uint8)


def _square_root(values: NDArray[np.generic]) -> NDArray[np.uint8]:
    linear = values.astype(np.float32)
    white = max(1.0, float(np.percentile(linear, _FULL)))
    return np.asarray(255 * np.sqrt(np.minimum(linear / white, 1)) + 0.5, np.uint8)


def _scaled_jpeg(path: Path, side: int) -> NDArray[np.uint8] | None:
    """Return a JPEG decoded at an eighth of its size or more, none of its sides below `side` if it need not; None for
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
