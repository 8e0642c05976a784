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
        pixels = _demosaiced(raw)
        matrix = _srgb_from_camera(raw)
    scaled = cv2.multiply(pixels, np.full(4, 65535 / span))  # rounds, and saturates at 65535
    return Development(np.asarray(scaled, np.uint16), matrix)


def half_size(path: Path) -> NDArray[np.uint16]:
    """One pixel a Bayer cell, black subtracted: (H, W, 3) uint16, linear. Raises `PhotographError`."""
    with _opened(path) as raw:
        return _demosaiced(raw, half_size=True)


def _demosaiced(raw: rawpy.RawPy, *, half_size: bool = False) -> NDArray[np.uint16]:
    pixels = raw.postprocess(
        demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,  # more correct matches than AHD, and faster
        half_size=half_size,
        gamma=(1, 1),
        no_auto_bright=True,
        no_auto_scale=True,
        output_bps=16,
        use_camera_wb=False,
        user_wb=[1, 1, 1, 1],
        output_color=rawpy.ColorSpace.raw,
        user_flip=0,
    )
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        pixels = np.repeat(pixels.reshape(*pixels.shape[:2], 1), 3, axis=2)
    return np.asarray(pixels, np.uint16)


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


@dataclass(frozen=True)
class Noted:
    """What LibRaw knows of a shot, whatever its maker's format: millimetres, seconds; 0 or empty if nothing."""

    focal_mm: float = 0.0
    exposure_s: float = 0.0
    f_number: float = 0.0
    iso: float = 0.0
    lens: str = ""
    lens_make: str = ""


def noted_by_libraw(path: Path) -> Noted:
    """Raises `PhotographError` if LibRaw refuses the file."""
    with _opened(path) as raw:
        if not hasattr(raw, "other"):  # rawpy before 0.26
            return Noted()
        shot, lens = raw.other, raw.lens
        return Noted(
            shot.focal_length, shot.shutter_speed, shot.aperture, shot.iso_speed, lens.model, lens.make
        )


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
    """As-shot white balance, then LibRaw's matrix to sRGB, whose rows sum to 1 so that white stays white."""
    balance = np.ones(3)
    for found in (raw.camera_whitebalance, raw.daylight_whitebalance):
        if found and np.isfinite(found[:3]).all() and min(found[:3]) > 0:
            balance = np.array(found[:3], np.float64) / found[1]
            break
    matrix = np.array(raw.color_matrix, np.float64)[:, :3]
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-6:
        matrix = np.eye(3)
    result: NDArray[np.float64] = matrix @ np.diag(balance)
    return result
