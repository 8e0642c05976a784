"""Photographs to arrays: colour as the file has it, upright as the sensor had it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.Image import Transpose
from PIL.TiffImagePlugin import TiffImageFile

from colmap_ihe.captures.discover import Capture
from colmap_ihe.captures.raw import develop, size_of
from colmap_ihe.errors import CapabilityError, PhotographError
from colmap_ihe.grey.weights import Encoding

MAX_PIXELS = 500_000_000
"""Of one photograph, checked before it is decoded: more is a damaged or a hostile header."""
Image.MAX_IMAGE_PIXELS = MAX_PIXELS
MIN_SIDE = 64
"""Pixels; a photograph with a shorter side holds nothing that COLMAP could match."""


def _zlib_clashes() -> bool:
    """Whether the system's zlib was loaded by pycolmap, and so with pycolmap's symbols in its place. A Python
    that has zlib built in is safe: it loaded the library first."""
    loaded = list(sys.modules)
    if "pycolmap" not in loaded or "zlib" in sys.builtin_module_names:
        return False
    return "zlib" not in loaded[: loaded.index("pycolmap")]


_ZLIB_CLASHES = _zlib_clashes()


_UNTURN = {
    2: Transpose.FLIP_LEFT_RIGHT,
    3: Transpose.ROTATE_180,
    4: Transpose.FLIP_TOP_BOTTOM,
    5: Transpose.TRANSPOSE,
    6: Transpose.ROTATE_90,
    7: Transpose.TRANSVERSE,
    8: Transpose.ROTATE_270,
}
"""By the Orientation tag, what takes back the turn it asks for."""


@dataclass(frozen=True)
class Photograph:
    """`rgb`: (H, W, 3); uint8 gamma-coded as stored if `encoding` is "coded", else uint16 linear with 65535
    at sensor saturation. `srgb_from_camera`: (3, 3) for the colour twin of a linear one, else None."""

    rgb: NDArray[np.uint8] | NDArray[np.uint16]
    encoding: Encoding
    srgb_from_camera: NDArray[np.float64] | None = None


def read_photograph(capture: Capture) -> Photograph:
    """Decodes a capture, pixels in the sensor's own orientation. Raises `PhotographError`."""
    try:
        if capture.kind == "raw":
            developed = develop(capture.path)
            photograph = Photograph(developed.linear_rgb, "linear", developed.srgb_from_camera)
        else:
            photograph = Photograph(_read_coded(capture.path), "coded")
    except (OSError, MemoryError, cv2.error) as error:
        raise _unreadable(capture, error) from error
    height, width = photograph.rgb.shape[:2]
    check_size(capture, width, height)
    return photograph


def read_size(capture: Capture) -> tuple[int, int]:
    """Width and height from the file's header, without decoding. Raises `PhotographError`."""
    if capture.kind == "raw":
        width, height = size_of(capture.path)
    else:
        try:
            with Image.open(capture.path) as image:
                width, height = _stored_size(image)
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            raise _unreadable(capture, error) from error
    check_size(capture, width, height)
    return width, height


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


def _read_coded(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8. Pillow, unlike OpenCV, reports a truncated file; OpenCV reads 16 bits a channel."""
    _refuse_zlib(path)
    try:
        with Image.open(path) as image:
            # Of a PNG's depth Pillow tells only before it decodes: "RGB;16B" is the mode in the file.
            deep = image.format == "PNG" and any("16" in str(tile.args) for tile in image.tile)
            turned = image.tag_v2.get(274, 1) if isinstance(image, TiffImageFile) else 1
            image.load()
            if deep or _is_deep(image):
                return _read_deep(path, turned)
            rgb = image if image.mode == "RGB" else image.convert("RGB")
            if turned in _UNTURN:  # Pillow turns a TIFF upright as it loads it; COLMAP must see it as stored
                rgb = rgb.transpose(_UNTURN[turned])
            return np.asarray(rgb)
    except (SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise OSError(str(error)) from error


def _is_deep(image: Image.Image) -> bool:
    """Whether the file holds 16 bits a channel, which Pillow cuts to 8 where it reads colour."""
    if image.mode.startswith(("I", "F")):
        return True
    if image.format == "TIFF":
        bits = getattr(image, "tag_v2", {}).get(258, (8,))
        return bool(max(bits if isinstance(bits, tuple) else (bits,)) > 8)
    return False


def _stored_size(image: Image.Image) -> tuple[int, int]:
    """Width and height as stored: Pillow swaps those of a TIFF by its Orientation."""
    if isinstance(image, TiffImageFile):
        return int(image.tag_v2[256]), int(image.tag_v2[257])
    return image.size


def _read_deep(path: Path, turned: int) -> NDArray[np.uint8]:
    """A 16-bit TIFF or PNG, coded, rounded to the 8 bits that COLMAP will see."""
    if turned in (5, 6, 7, 8):  # OpenCV 5 fails on these, whatever it is told of orientation
        pixels = _read_with_tifffile(path)
    else:
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        found = cv2.imread(str(path), flags)
        if found is None:
            raise OSError("OpenCV cannot decode it")
        pixels = np.asarray(found)[..., ::-1]
    if pixels.dtype != np.uint16:
        raise OSError(f"holds {pixels.dtype} pixels; wanted 8 or 16 bit integers")
    rounded = (pixels.astype(np.uint32) + 128) // 257  # 65535 = 257 x 255
    return np.ascontiguousarray(rounded, np.uint8)


def _read_with_tifffile(path: Path) -> NDArray[np.generic]:
    try:
        pixels = np.asarray(tifffile.imread(path))
    except Exception as error:
        raise OSError(f"{error}; a turned 16-bit TIFF can be read if it is not compressed") from error
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=2)
    return pixels[..., :3]


def _refuse_zlib(path: Path) -> None:
    if _ZLIB_CLASHES and path.suffix.lower() in (".png", ".tif", ".tiff"):
        raise CapabilityError(
            f"{path.name}: PNG and TIFF cannot be read, pycolmap was imported before colmap_ihe",
            hint="import colmap_ihe first: pycolmap's zlib would corrupt the memory of this process",
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
