"""JPEG, HEIC, TIFF and PNG to 8-bit RGB as stored. What each kind of file becomes: docs/photographs.md."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
import simplejpeg
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.Image import Transpose
from PIL.ImageFile import ImageFile
from PIL.TiffImagePlugin import TiffImageFile

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_wire import answer_array
from colmap_ihe.photographs import heic
from colmap_ihe.photographs.container import not_turned, without_text
from colmap_ihe.photographs.icc_profile import cmyk_to_srgb, rgb_profile
from colmap_ihe.photographs.linear_tiff import SensorColours, sensor_colours

MAX_PIXELS = 500_000_000
"""Of one photograph, checked before it is decoded: more is a damaged or a hostile header."""
Image.MAX_IMAGE_PIXELS = MAX_PIXELS
FORMATS = ("JPEG", "PNG", "TIFF", "HEIF")
"""Of Pillow's: for a file of some others, whatever its name, it would run a program, as Ghostscript for EPS."""

_ORIENTATION, _BITS, _PHOTOMETRIC, _PLANES, _SAMPLE_FORMAT = 274, 258, 262, 284, 339  # tags of TIFF 6.0
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _SEPARATED = 0, 1, 2, 5
_UNSIGNED = 1

_DAMAGE = re.compile(
    "bad (Huffman|arithmetic) code|premature end of data|found marker|Inconsistent progression"
)
"""libjpeg's warnings of pixels that are lost; others are of bytes too many, or of what some cameras write."""

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


def read_coded(path: Path, accept: Callable[[int, int], None]) -> tuple[NDArray[np.uint8], bytes]:
    """Return pixels (H, W, 3) uint8, and the RGB profile they are in, empty for sRGB. Of several pages the first;
    alpha is ignored. Pillow, unlike OpenCV, reports a truncated file; OpenCV reads 16 bits a channel.
    `accept(width, height)` may raise before there is memory for them.

    Raises OSError for a broken file, `PhotographError` for a kind that is not read.
    """
    with _opened(path) as (file, image):
        width, height = _size_of(path, image)
        accept(width, height)
        pixels, profile = _read(path, file, image)
    if pixels.shape != (height, width, 3):
        size = f"{pixels.shape[1]}x{pixels.shape[0]}"
        raise OSError(f"{size} pixels where its header says {width}x{height}")
    return pixels, profile


@contextmanager
def _opened(path: Path) -> Iterator[tuple[BinaryIO, ImageFile]]:
    heic.register()
    try:
        with path.open("rb") as file, Image.open(without_text(file), formats=FORMATS) as image:
            yield file, image
    except UnidentifiedImageError:
        _raise_if_not_read(path)
        raise
    except (SyntaxError, ValueError, KeyError, Image.DecompressionBombError) as error:
        raise OSError(str(error)) from error


def _read(path: Path, file: BinaryIO, image: ImageFile) -> tuple[NDArray[np.uint8], bytes]:
    """Return what `read_coded` does, of a file that Pillow has opened; some kinds are opened again for other
    libraries."""
    # Of a PNG's depth Pillow tells only before it decodes: "RGB;16B" is the mode in the file.
    deep = image.format == "PNG" and any("16" in str(tile.args) for tile in image.tile)
    turned = _turn_of(path, image)
    if isinstance(image, TiffImageFile) and _is_deep(image):
        return _read_deep_tiff(path, image)
    if image.format == "JPEG" and image.mode == "RGB":
        pixels = _decode_jpeg(file, answer_array((image.height, image.width, 3), np.uint8))
        if pixels is not None:
            return pixels, rgb_profile(image)
    image.load()
    profile = rgb_profile(image)
    if deep:
        return _to_8_bit(_read_with_opencv(path)), profile
    rgb = cmyk_to_srgb(image, path.name) if image.mode == "CMYK" else image.convert("RGB")
    if turned in _UNTURN:  # TIFF and HEIC come upright; COLMAP must see them as stored
        rgb = rgb.transpose(_UNTURN[turned])
    return np.asarray(rgb), profile


def _decode_jpeg(file: BinaryIO, pixels: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Fill `pixels` (H, W, 3) from a sound JPEG, three times faster than Pillow and to the same pixels; return None
    for one that libjpeg warns of, which Pillow judges. Raises OSError where the warning is of damage, which Pillow
    passes over."""
    try:
        file.seek(0)
        decoded = simplejpeg.decode_jpeg(file.read(), "RGB", buffer=pixels, strict=True)
    except ValueError as error:
        if _DAMAGE.search(str(error)):
            raise OSError(str(error)) from error
        return None
    return pixels if decoded.shape == pixels.shape else None


def read_linear(path: Path, accept: Callable[[int, int], None]) -> tuple[NDArray[np.uint16], SensorColours]:
    """Return the pixels (H, W, 3) uint16 of a TIFF that holds the linear colours of a sensor, as stored, and what they
    are. Raises as `read_coded`, OSError for another kind of file."""
    with _opened(path) as (_, image):
        accept(*_size_of(path, image))
        colours = _colours_of(image)
        if colours is None or not isinstance(image, TiffImageFile):
            raise OSError("does not say that its colours are linear, as it did before")
        pixels = _deep_pixels(path, image)
    if pixels.dtype != np.uint16 or pixels.shape[2:] != (3,):
        raise OSError(f"holds {pixels.dtype} pixels of {pixels.shape[2]} channels; expected RGB of 16 bit")
    return np.asarray(pixels, np.uint16), colours


def stored_header(path: Path) -> tuple[int, int, SensorColours | None]:
    """Return width and height as stored, from the header (Pillow swaps those of a TIFF by its Orientation), and what
    linear colours are, None for others. Raises as `read_coded`."""
    with _opened(path) as (_, image):
        return *_size_of(path, image), _colours_of(image)


def _colours_of(image: Image.Image) -> SensorColours | None:
    if not isinstance(image, TiffImageFile) or rgb_profile(image):
        return None
    is_rgb = image.tag_v2.get(_BITS) == (16, 16, 16) and image.tag_v2.get(_PHOTOMETRIC) == _RGB
    return sensor_colours(image.tag_v2) if is_rgb else None


def _size_of(path: Path, image: Image.Image) -> tuple[int, int]:
    if isinstance(image, TiffImageFile):
        return int(image.tag_v2[256]), int(image.tag_v2[257])
    swapped = image.format == "HEIF" and _turn_of(path, image) in (6, 8)
    return image.size[::-1] if swapped else image.size


def _turn_of(path: Path, image: Image.Image) -> int:
    """Return the Orientation by which Pillow turns the pixels upright as it loads them."""
    if isinstance(image, TiffImageFile):
        return int(image.tag_v2.get(_ORIENTATION, 1))
    return heic.orientation_of(image, path)


def _raise_if_not_read(path: Path) -> None:
    """Raise `PhotographError` if the file is a sound TIFF of a kind that Pillow does not know, as colour in floating
    point."""
    try:
        with tifffile.TiffFile(path) as tiff:
            page = tiff.pages.first
            kind, channels, odd_order = (
                page.dtype,
                page.samplesperpixel,
                tiff.is_bigtiff and tiff.byteorder == ">",
            )
    except Exception:  # noqa: BLE001  a broken file, of which the caller has its own words
        return
    if odd_order:
        raise PhotographError(f"{path.name}: is a big-endian BigTIFF", hint="save it as a plain TIFF")
    if kind in (np.uint8, np.uint16):
        raise PhotographError(
            f"{path.name}: holds {channels} channels of {8 * kind.itemsize} bit; expected grey, RGB, RGBA or CMYK",
            hint="export it without the additional channels",
        )
    raise _not_read(path, f"{kind} pixels")


def _is_deep(image: TiffImageFile) -> bool:
    """Tell whether the file holds more than 8 bits a channel, which Pillow cuts to 8 where it reads colour."""
    bits = image.tag_v2.get(_BITS, (8,))
    return max(bits if isinstance(bits, tuple) else (bits,)) > 8 or image.mode.startswith(("I", "F"))


def _read_deep_tiff(path: Path, image: TiffImageFile) -> tuple[NDArray[np.uint8], bytes]:
    """Read a TIFF of 16-bit integers, coded; refuse floating point, whose numbers have no level of their own."""
    tags = image.tag_v2
    bits, formats, photometric = set(tags[_BITS]), set(tags.get(_SAMPLE_FORMAT, ())), tags.get(_PHOTOMETRIC)
    if formats - {_UNSIGNED}:
        raise _not_read(path, "floating-point pixels" if 3 in formats else "signed pixels")
    if bits != {16} or photometric not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _SEPARATED):
        raise _not_read(path, f"{max(bits)}-bit pixels of TIFF's colour kind {photometric}")
    pixels = _to_8_bit(_deep_pixels(path, image))
    if photometric == _WHITE_IS_ZERO:
        pixels = np.asarray(255 - pixels, np.uint8)
    if photometric == _SEPARATED:
        inks = Image.fromarray(np.ascontiguousarray(pixels[..., :4]), "CMYK")
        inks.info["icc_profile"] = image.info.get("icc_profile")
        return np.asarray(cmyk_to_srgb(inks, path.name)), b""
    return np.ascontiguousarray(pixels[..., :3]), rgb_profile(image)


def _deep_pixels(path: Path, image: TiffImageFile) -> NDArray[np.generic]:
    """Return the pixels of a TIFF of 16 bits, (H, W, channels), as stored."""
    tags = image.tag_v2
    # OpenCV 5 misreads separate planes and refuses CMYK.
    if tags.get(_PLANES, 1) != 1 or tags.get(_PHOTOMETRIC) == _SEPARATED:
        return _read_with_tifffile(path)
    return _read_with_opencv(path)


def _to_8_bit(pixels: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return 16 bits rounded to the 8 that COLMAP will see."""
    if pixels.dtype != np.uint16:
        raise OSError(f"holds {pixels.dtype} pixels; expected 8 or 16 bit integers")
    return np.asarray((pixels.astype(np.uint32) + 128) // 257, np.uint8)  # 65535 = 257 x 255


def _read_with_opencv(path: Path) -> NDArray[np.generic]:
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(not_turned(path), flags)
    if pixels is None:
        raise OSError("OpenCV cannot decode it")
    return np.ascontiguousarray(np.asarray(pixels)[..., ::-1])


def _read_with_tifffile(path: Path) -> NDArray[np.generic]:
    """Return (H, W, channels), three channels for grey."""
    try:
        with tifffile.TiffFile(path) as tiff:
            page = tiff.pages.first
            if not page.is_contiguous and len(page.dataoffsets) * math.prod(page.chunks) < page.size:
                raise OSError("some of its pixels are missing")  # else what memory held before
            pixels = np.asarray(page.asarray())
            axes = page.axes
    except OSError:
        raise
    except Exception as error:
        raise OSError(
            f"{error}; a 16-bit TIFF that is planar or CMYK can be read if it is not compressed"
        ) from error
    if axes == "SYX":
        pixels = np.moveaxis(pixels, 0, 2)
    return np.repeat(pixels[..., None], 3, axis=2) if pixels.ndim == 2 else pixels


def _not_read(path: Path, what: str) -> PhotographError:
    return PhotographError(
        f"{path.name}: holds {what}; expected 8 or 16 bit integers, grey, RGB or CMYK",
        hint="export it as a 16-bit TIFF",
    )
