"""Photographs to arrays: colour as the file has it, upright as the sensor had it.

`read_photograph` and `read_size` have a decoder do it, in a process of its own.
"""

from __future__ import annotations

import errno
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import UnidentifiedImageError

from colmap_ihe.errors import PhotographError
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.machine.decoder_pool import in_decoder
from colmap_ihe.machine.decoder_process import BROKEN, nonsense
from colmap_ihe.photographs import developed_cache
from colmap_ihe.photographs.adjust import prepared
from colmap_ihe.photographs.coded import MAX_PIXELS, read_coded, read_linear, stored_header
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.file_kinds import advice_on, kind_by_content
from colmap_ihe.photographs.icc_profile import to_srgb
from colmap_ihe.photographs.raw.develop import develop, read_header
from colmap_ihe.photographs.raw.undecoded import refuse_damaged

MIN_SIDE = 64
"""Pixels; a photograph with a shorter side holds nothing that COLMAP could match."""


@dataclass(frozen=True)
class PhotographHeader:
    """Hold what is known before the pixels are decoded: width and height in pixels; `sensor`: the kind of a RAW file's,
    else empty; of linear photographs the white balance of the shot, factors of red, green and blue, else empty."""

    width: int
    height: int
    sensor: str = ""
    white_balance: tuple[float, ...] = ()


@dataclass(frozen=True)
class DecodedPhotograph:
    """Hold `rgb`: (H, W, 3); uint8 gamma-coded as stored if `encoding` is "coded", else uint16 linear with 65535
    at sensor saturation. `srgb_from_camera`: (3, 3) for the colour twin of a linear one, else None.
    `profile`: the ICC profile of coded RGB, empty for sRGB."""

    rgb: NDArray[np.uint8] | NDArray[np.uint16]
    encoding: Encoding
    srgb_from_camera: NDArray[np.float64] | None = None
    profile: bytes = b""

    def __post_init__(self) -> None:
        """Raise ValueError for another shape or dtype."""
        rgb, matrix = self.rgb, self.srgb_from_camera
        if rgb.shape[2:] != (3,) or rgb.dtype != (np.uint8 if self.encoding == "coded" else np.uint16):
            raise ValueError(f"{self.encoding} pixels: {rgb.shape=} {rgb.dtype=}")
        if matrix is not None and matrix.shape != (3, 3):
            raise ValueError(f"{matrix.shape=}, expected (3, 3)")


def encoding_of(capture: Capture) -> Encoding:
    """Return the encoding that a capture will have, known before it is read."""
    return "linear" if capture.kind == "raw" or capture.recipe.linear else "coded"


def read_photograph(capture: Capture) -> DecodedPhotograph:
    """Decode a capture as its recipe says, pixels in the sensor's own orientation. `rgb` lies in memory shared with no
    one any more. Raises `PhotographError`, also where the decoder crashed or did not end; `CapabilityError`."""
    photograph = in_decoder(decode_photograph, capture, pixels=capture.pixels)
    if photograph.encoding != encoding_of(capture):
        raise nonsense(capture.name, f"{photograph.encoding} pixels")
    return photograph


def read_srgb(capture: Capture, profile_name: str) -> NDArray[np.uint8]:
    """Return the pixels of a gamma-coded capture in sRGB, (H, W, 3) uint8, upright as the sensor had it. `profile_name`
    as its metadata has it. Raises as `read_photograph`."""
    rgb = in_decoder(decode_srgb, capture, profile_name, pixels=capture.pixels)
    if rgb.dtype != np.uint8 or rgb.shape[2:] != (3,):
        raise nonsense(capture.name, f"{rgb.shape=} {rgb.dtype=}")
    return rgb


def decode_srgb(capture: Capture, profile_name: str) -> NDArray[np.uint8]:
    """Return what `read_srgb` does, in this process."""
    photograph = decode_photograph(capture)
    return to_srgb(np.asarray(photograph.rgb, np.uint8), photograph.profile, profile_name)


def decode_photograph(capture: Capture) -> DecodedPhotograph:
    """Decode a capture in this process, or find it developed where its recipe keeps it; as `read_photograph`."""
    file = developed_cache.kept_file(capture)
    if file is not None and (kept := developed_cache.load(file)):
        return DecodedPhotograph(kept[0], "linear", kept[1])
    try:
        if capture.kind == "raw":
            decode_size(capture)  # what is too large is refused before there is memory for it
            developed = develop(capture.path, capture.recipe)
            photograph = DecodedPhotograph(developed.linear_rgb, "linear", developed.srgb_from_camera)
        elif capture.recipe.linear:
            linear_rgb, colours = read_linear(capture.path, partial(check_size, capture.name))
            matrix = colours.srgb_from_camera(capture.recipe.white_balance)
            photograph = DecodedPhotograph(linear_rgb, "linear", matrix)
        else:
            rgb, profile = read_coded(capture.path, partial(check_size, capture.name))
            photograph = DecodedPhotograph(rgb, "coded", profile=profile)
    except (OSError, cv2.error) as error:
        raise _unreadable(capture, error) from error
    photograph = replace(photograph, rgb=prepared(photograph.rgb, capture.recipe))
    refuse_damaged(capture.name)
    if file is not None:
        developed_cache.store(file, photograph.rgb, photograph.srgb_from_camera)
    return photograph


def read_size(capture: Capture) -> PhotographHeader:
    """Return what a file's header says, without decoding its pixels. Raises `PhotographError`, `CapabilityError`."""
    return in_decoder(decode_size, capture)


def decode_size(capture: Capture) -> PhotographHeader:
    """Return what `read_size` does, in this process."""
    if capture.kind == "raw":
        _require_readable(capture)
        raw = read_header(capture.path)
        header = PhotographHeader(raw.width, raw.height, raw.sensor, raw.white_balance)
    else:
        try:
            width, height, colours = stored_header(capture.path)
        except OSError as error:
            raise _unreadable(capture, error) from error
        header = PhotographHeader(width, height, "", colours.white_balance if colours else ())
    check_size(capture.name, header.width, header.height)
    return header


def _require_readable(capture: Capture) -> None:
    """Raise `PhotographError` for a file that the system does not open, of which LibRaw has no cause."""
    try:
        with capture.path.open("rb") as file:
            empty = not file.read(1)
    except OSError as error:
        raise _unreadable(capture, error) from error
    if empty:
        raise PhotographError(f"{capture.name}: cannot be read (it is empty)", hint=BROKEN)


def check_size(name: str, width: int, height: int) -> None:
    """Raise `PhotographError` for a size in pixels that is never decoded, or shows too little."""
    refuse_too_large(name, width, height)
    if min(width, height) < MIN_SIDE:
        raise PhotographError(
            f"{name}: {width}x{height} pixels, expected at least {MIN_SIDE} on each side",
            hint="take it out of the folder, or put the full-size photograph in its place",
        )


def refuse_too_large(name: str, width: int, height: int) -> None:
    """Raise `PhotographError` for more pixels than are ever decoded."""
    if width * height > MAX_PIXELS:
        raise PhotographError(
            f"{name}: {width}x{height} pixels, expected at most {MAX_PIXELS // 10**6} megapixels",
            hint="take it out of the folder, or cut it up",
        )


def _unreadable(capture: Capture, error: BaseException) -> PhotographError:
    """Return the error of a file that is damaged, or of a kind that is not read, with what to do."""
    if not isinstance(error, UnidentifiedImageError):
        reason = (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
        return PhotographError(f"{capture.name}: cannot be read ({reason})", hint=_hint_for(error))
    if not capture.path.stat().st_size:
        return PhotographError(f"{capture.name}: cannot be read (it is empty)", hint=BROKEN)
    if kind := kind_by_content(capture.path):
        return PhotographError(f"{capture.name}: is a {kind}, whatever its name", hint=advice_on(kind))
    return PhotographError(
        f"{capture.name}: cannot be read (not a photograph of the kind its name says)", hint=BROKEN
    )


def _hint_for(error: BaseException) -> str:
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.EACCES, errno.EPERM):
        return "give read permission"
    if number in (errno.ENOENT, errno.ENOTDIR):
        return "put it back, or go on without it: by the same command"
    return BROKEN
