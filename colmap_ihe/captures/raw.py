"""Minimal RAW development: black point and demosaicing, nothing else.

No white balance, no colour matrix, no gamma, no denoising, no sharpening, and the sensor's own orientation.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rawpy
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError

# XYZ (D65) from linear sRGB, IEC 61966-2-1.
_XYZ_FROM_SRGB = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


@dataclass(frozen=True)
class Development:
    """`linear_rgb`: (H, W, 3) uint16, linear, 65535 at sensor saturation, the sensor's own colours.
    `srgb_from_camera`: (3, 3) float64, as-shot white balance and colour matrix in one, for the colour twin
    only; camera white becomes (1, 1, 1)."""

    linear_rgb: NDArray[np.uint16]
    srgb_from_camera: NDArray[np.float64]


def develop(path: Path) -> Development:
    """Develops one RAW file. Raises `PhotographError` if LibRaw refuses it."""
    with _opened(path) as raw:
        if raw.num_colors not in (1, 3):
            raise PhotographError(
                f"{path.name}: a sensor of {raw.num_colors} colours; wanted red, green and blue",
                hint="convert it to TIFF with the maker's program",
            )
        black = min(raw.black_level_per_channel or [0])
        span = float(raw.white_level) - black
        if span < 1:
            raise PhotographError(
                f"{path.name}: white level {raw.white_level} is not above black level {black}",
                hint="the file is damaged; take it out of the folder",
            )
        pixels = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            no_auto_scale=True,
            output_bps=16,
            use_camera_wb=False,
            user_wb=[1, 1, 1, 1],
            output_color=rawpy.ColorSpace.raw,
            user_flip=0,
        )
        matrix = _srgb_from_camera(raw)
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        pixels = np.repeat(pixels.reshape(*pixels.shape[:2], 1), 3, axis=2)
    scaled = cv2.multiply(pixels, np.full(4, 65535 / span))  # rounds, and saturates at 65535
    return Development(np.asarray(scaled, np.uint16), matrix)


def size_of(path: Path) -> tuple[int, int]:
    """Width and height that `develop` will give. Raises `PhotographError`."""
    with _opened(path) as raw:
        return int(raw.sizes.width), int(raw.sizes.height)


def preview_of(path: Path) -> bytes:
    """The JPEG preview inside a RAW file, empty if there is none. Raises `PhotographError`."""
    with _opened(path) as raw:
        try:
            thumb = raw.extract_thumb()
        except rawpy.LibRawError:
            return b""
    return bytes(thumb.data) if thumb.format == rawpy.ThumbFormat.JPEG else b""


@contextmanager
def _opened(path: Path) -> Iterator[rawpy.RawPy]:
    try:
        with rawpy.imread(str(path)) as raw:
            yield raw
    except rawpy.LibRawError as error:
        reason = str(error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error)
        raise PhotographError(
            f"{path.name}: LibRaw cannot read this RAW file ({reason})",
            hint="copy it from the card again, or convert it to DNG or TIFF",
        ) from error


def _srgb_from_camera(raw: rawpy.RawPy) -> NDArray[np.float64]:
    """White balance, then the camera's matrix normalised so that white stays white (dcraw's cam_xyz)."""
    balance = np.array(raw.camera_whitebalance[:3], np.float64)
    if not (np.isfinite(balance).all() and (balance > 0).all()):
        balance = np.array(raw.daylight_whitebalance[:3], np.float64)
    if not (np.isfinite(balance).all() and (balance > 0).all()):
        balance = np.ones(3)
    camera_from_srgb = np.array(raw.rgb_xyz_matrix[:3], np.float64) @ _XYZ_FROM_SRGB
    rows = camera_from_srgb.sum(axis=1, keepdims=True)
    matrix = np.eye(3)
    if (np.abs(rows) > 1e-6).all() and abs(np.linalg.det(camera_from_srgb / rows)) > 1e-6:
        matrix = np.linalg.inv(camera_from_srgb / rows)
    result: NDArray[np.float64] = matrix @ np.diag(balance / balance[1])
    return result
