"""Photographs to arrays: colour as the file has it, upright as the sensor had it.

`read_photograph` and `read_size` have a decoder do it, in a process of its own; the functions that end in
`_here` are what it does there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import UnidentifiedImageError

from colmap_ihe.errors import PhotographError
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.photographs.adjust import prepared
from colmap_ihe.photographs.coded import MAX_PIXELS, read_coded, stored_size
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.raw.develop import develop, read_header

MIN_SIDE = 64
"""Pixels; a photograph with a shorter side holds nothing that COLMAP could match."""


@dataclass(frozen=True)
class DecodedPhotograph:
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


def read_photograph(capture: Capture) -> DecodedPhotograph:
    """Decodes a capture, pixels in the sensor's own orientation. `rgb` lies in memory shared with no one any
    more. Raises `PhotographError`, also where the decoder crashed or did not end; `CapabilityError`."""
    found, rgb = decoders.ask("photograph", capture.name, capture.pixels, capture=message_of(capture))
    if rgb is None:
        raise PhotographError(f"{capture.name}: the decoder returned no pixels")
    with decoders.understood(capture.name):
        matrix = found["matrix"]
        srgb_from_camera = None if matrix is None else np.array(matrix, np.float64).reshape(3, 3)
        kind = np.uint8 if encoding_of(capture) == "coded" else np.uint16
        if rgb.dtype != kind or rgb.shape[2:] != (3,) or found["encoding"] != encoding_of(capture):
            raise ValueError(f"{rgb.dtype} pixels of {rgb.shape}")
        if not isinstance(found["profile"], bytes):
            raise TypeError("a profile that is no bytes")
        return DecodedPhotograph(rgb, found["encoding"], srgb_from_camera, found["profile"])


def read_photograph_here(capture: Capture, room: Callable[..., NDArray[Any]] = np.empty) -> DecodedPhotograph:
    """As `read_photograph`, in this process. `room(shape, dtype)` may be asked for the array to decode into."""
    try:
        if capture.kind == "raw":
            read_size_here(capture)  # what is too large is refused before there is memory for it
            developed = develop(capture.path, capture.recipe)
            photograph = DecodedPhotograph(developed.linear_rgb, "linear", developed.srgb_from_camera)
        else:
            rgb, profile = read_coded(capture.path, partial(check_size, capture.name), room)
            photograph = DecodedPhotograph(rgb, "coded", profile=profile)
    except (OSError, cv2.error) as error:
        raise _unreadable(capture, error) from error
    return replace(photograph, rgb=prepared(photograph.rgb, capture.recipe))


def message_of(capture: Capture) -> dict[str, Any]:
    """What a decoder is told of a capture, in plain values."""
    return {
        "name": capture.name,
        "path": str(capture.path.absolute()),
        "kind": capture.kind,
        "grey_stem": capture.grey_stem,
        "recipe": capture.recipe.as_dict(),
    }


def read_size(capture: Capture) -> tuple[int, int, str]:
    """Width, height and, of a RAW file, the kind of sensor, from the file's header, without decoding. Raises
    `PhotographError`, `CapabilityError`."""
    found, _ = decoders.ask("size", capture.name, capture=message_of(capture))
    with decoders.understood(capture.name):
        width, height, sensor = found
        return int(width), int(height), str(sensor)


def read_size_here(capture: Capture) -> tuple[int, int, str]:
    """As `read_size`, in this process."""
    sensor = ""
    if capture.kind == "raw":
        header = read_header(capture.path)
        width, height, sensor = header.width, header.height, header.sensor
    else:
        try:
            width, height = stored_size(capture.path)
        except OSError as error:
            raise _unreadable(capture, error) from error
    check_size(capture.name, width, height)
    return width, height, sensor


def check_size(name: str, width: int, height: int) -> None:
    refuse_too_large(name, width, height)
    if min(width, height) < MIN_SIDE:
        raise PhotographError(
            f"{name}: {width}x{height} pixels, wanted at least {MIN_SIDE} on each side",
            hint="take it out of the folder, or put the full-size photograph in its place",
        )


def refuse_too_large(name: str, width: int, height: int) -> None:
    """Raises `PhotographError` for more pixels than are ever decoded."""
    if width * height > MAX_PIXELS:
        raise PhotographError(
            f"{name}: {width}x{height} pixels, wanted at most {MAX_PIXELS // 10**6} megapixels",
            hint="take it out of the folder, or cut it up",
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
