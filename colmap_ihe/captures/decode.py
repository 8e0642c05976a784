"""Photographs to arrays: colour as the file has it, upright as the sensor had it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import UnidentifiedImageError

from colmap_ihe.captures.coded import MAX_PIXELS, read_coded, stored_size
from colmap_ihe.captures.discover import Capture
from colmap_ihe.captures.prepare import prepared
from colmap_ihe.captures.raw import develop, read_header
from colmap_ihe.errors import PhotographError
from colmap_ihe.grey.weights import Encoding

MIN_SIDE = 64
"""Pixels; a photograph with a shorter side holds nothing that COLMAP could match."""


@dataclass(frozen=True)
class Photograph:
    """`rgb`: (H, W, 3); uint8 gamma-coded as stored if `encoding` is "coded", else uint16 linear with 65535
    at sensor saturation. `srgb_from_camera`: (3, 3) for the colour twin of a linear one, else None.
    `profile`: the ICC profile of coded RGB, empty for sRGB."""

    rgb: NDArray[np.uint8] | NDArray[np.uint16]
    encoding: Encoding
    srgb_from_camera: NDArray[np.float64] | None = None
    profile: bytes = b""


def encoding_of(capture: Capture) -> Encoding:
    """Known before it is read."""
    return "linear" if capture.kind == "raw" else "coded"


def read_photograph(capture: Capture) -> Photograph:
    """Decodes a capture, pixels in the sensor's own orientation. Raises `PhotographError`."""
    try:
        if capture.kind == "raw":
            developed = develop(capture.path, capture.recipe)
            photograph = Photograph(developed.linear_rgb, "linear", developed.srgb_from_camera)
        else:
            rgb, profile = read_coded(capture.path)
            photograph = Photograph(rgb, "coded", profile=profile)
    except (OSError, MemoryError, cv2.error) as error:
        raise _unreadable(capture, error) from error
    height, width = photograph.rgb.shape[:2]
    check_size(capture, width, height)
    return replace(photograph, rgb=prepared(photograph.rgb, capture.recipe))


def read_size(capture: Capture) -> tuple[int, int, str]:
    """Width, height and, of a RAW file, the kind of sensor, from the file's header, without decoding. Raises
    `PhotographError`."""
    sensor = ""
    if capture.kind == "raw":
        header = read_header(capture.path)
        width, height, sensor = header.width, header.height, header.sensor
    else:
        try:
            width, height = stored_size(capture.path)
        except OSError as error:
            raise _unreadable(capture, error) from error
    check_size(capture, width, height)
    return width, height, sensor


def check_size(capture: Capture, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise PhotographError(
            f"{capture.name}: {width}x{height} pixels, wanted at most {MAX_PIXELS // 10**6} megapixels",
            hint="take it out of the folder, or cut it up",
        )
    if min(width, height) < MIN_SIDE:
        raise PhotographError(
            f"{capture.name}: {width}x{height} pixels, wanted at least {MIN_SIDE} on each side",
            hint="take it out of the folder, or put the full-size photograph in its place",
        )


def _unreadable(capture: Capture, error: BaseException) -> PhotographError:
    if isinstance(error, UnidentifiedImageError):
        reason = "not a photograph of the kind its name says"
    else:
        reason = str(error) or type(error).__name__
    return PhotographError(
        f"{capture.name}: cannot be read ({reason})",
        hint="copy it from the card again, or take it out of the folder",
    )
