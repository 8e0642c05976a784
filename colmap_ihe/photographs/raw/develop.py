"""RAW files through LibRaw: what the sensor saw, and the minimal development of it.

No white balance, no colour matrix, no gamma, no denoising, no sharpening, and the sensor's own orientation.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import rawpy
from numpy.typing import NDArray

with warnings.catch_warnings():  # of scikit-image missing, which it does not need on Bayer sensors
    warnings.simplefilter("ignore")
    from rawpy.enhance import find_bad_pixels

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_process import BROKEN
from colmap_ihe.photographs.raw.cut_short import refuse_cut_short
from colmap_ihe.photographs.raw.dng_black import black_plane
from colmap_ihe.photographs.raw.mosaic import FULL, Frames, Mosaic, calibrated
from colmap_ihe.photographs.raw.undecoded import refuse_damaged, unpack
from colmap_ihe.project.recipe import Demosaic, Recipe

_UNKNOWN = (rawpy.LibRawFileUnsupportedError, rawpy.LibRawNotImplementedError)
_CONVERT = (
    "if other files of this camera can be read, copy it from the card again; else convert it to DNG or TIFF with the"
    " maker's program, or take it out: a JPEG of the same name is then used"
)
_HEADS = re.compile(rb"II|MM|....ftyp|FUJIFILM|FOVb|\0MRM|NOKIARAW|ARRI|YZ|\xff\xd8", re.DOTALL)
"""Of RAW files: those of TIFF's kind, of MP4's, and those of makers' own."""
Sensor = Literal["bayer", "x-trans", "mosaic", "monochrome", "demosaiced"]
"""`mosaic`: of another pattern. `demosaiced`: sRAW, linear DNG, and sensors with three layers."""


@dataclass(frozen=True)
class Development:
    """Hold `linear_rgb`: (H, W, 3) uint16, linear, 65535 at sensor saturation, the sensor's own colours.
    `srgb_from_camera`: (3, 3) float64, white balance and colour matrix in one, for the colour twin only; camera white
    becomes (1, 1, 1)."""

    linear_rgb: NDArray[np.uint16]
    srgb_from_camera: NDArray[np.float64]


@dataclass(frozen=True)
class RawHeader:
    """Hold width and height of what `develop` gives, in pixels, the kind of sensor, and the white balance of the shot:
    factors of red, green and blue, 1 for green."""

    width: int
    height: int
    sensor: Sensor
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)


def develop(path: Path, recipe: Recipe | None = None) -> Development:
    """Develop one RAW file. Raises `PhotographError` if LibRaw refuses it, or its frames do not fit."""
    recipe = recipe or Recipe()
    with _opened(path) as raw:
        unpack(raw, path)
        if raw.raw_type == rawpy.RawType.Flat:
            mosaic, frames, even = _mosaic(raw, path), frames_of(recipe), recipe.green_equilibrium
            try:
                calibrated(mosaic, frames, green_equilibrium=even, out=raw.raw_image_visible)
            except ValueError as error:
                raise PhotographError(
                    f"{path.name}: a calibration frame is of another size ({error})",
                    hint="take the frames with the same camera, at its full size",
                ) from error
        else:
            _scale_layers(raw, path)
        # of values that are between black 0 and white 65535 already
        levels: dict[str, Any] = {"user_black": 0, "user_cblack": [0, 0, 0, 0], "user_sat": FULL}
        balance = recipe.white_balance or _as_shot(raw)
        return Development(_postprocessed(raw, recipe.demosaic, **levels), _srgb_from_camera(raw, balance))


def read_mosaic(path: Path) -> Mosaic:
    """Return what the sensor saw. Raises `PhotographError`, also for a file that is demosaiced already."""
    with _opened(path) as raw:
        unpack(raw, path)
        if raw.raw_type != rawpy.RawType.Flat:
            raise PhotographError(
                f"{path.name}: is demosaiced already, and has no mosaic", hint="use the camera's full RAW"
            )
        mosaic = _mosaic(raw, path)
        refuse_damaged(path.name)
        return replace(mosaic, values=mosaic.values.copy())


def bad_pixel_candidates(path: Path) -> NDArray[np.intp]:
    """Return (N, 2), row and column of the pixels that stand out from those of their colour around them, of a Bayer
    sensor: bad ones, and fine detail. Raises `PhotographError`."""
    with _opened(path):  # for the words of what is wrong with it
        return np.asarray(find_bad_pixels([str(path)]), np.intp)


def half_size(path: Path) -> NDArray[np.uint16]:
    """Return one pixel a Bayer cell, black subtracted: (H, W, 3) uint16, linear. Raises `PhotographError`."""
    with _opened(path) as raw:
        return _postprocessed(raw, "linear", half_size=True)


def read_header(path: Path) -> RawHeader:
    """Return what is known before the pixels are decoded. Raises `PhotographError`."""
    with _opened(path) as raw:
        return RawHeader(int(raw.sizes.width), int(raw.sizes.height), _sensor(raw), _as_shot(raw))


def preview_of(path: Path) -> bytes:
    """Return the JPEG preview inside a RAW file, empty if there is none. Raises `PhotographError`."""
    with _opened(path) as raw:
        try:
            thumb = raw.extract_thumb()
        except rawpy.LibRawError:
            return b""
    return bytes(thumb.data) if thumb.format == rawpy.ThumbFormat.JPEG else b""


def frames_of(recipe: Recipe) -> Frames:
    """Return the calibration frames that a recipe names. Frames are mapped, not read: workers share their pages."""

    def load(name: str) -> NDArray[np.float32] | None:
        return np.load(name, mmap_mode="r", allow_pickle=False) if name else None

    dark = load(recipe.dark)
    if recipe.bias:
        bias = load(recipe.bias)
        dark = bias if dark is None or bias is None else bias + np.float32(recipe.dark_scale) * (dark - bias)
    bad = np.load(recipe.bad_pixels, allow_pickle=False) if recipe.bad_pixels else None
    return Frames(dark, load(recipe.flat), bad)


@dataclass(frozen=True)
class LibrawMetadata:
    """Hold what LibRaw knows of a shot, whatever its maker's format: millimetres, seconds; 0 or empty if nothing."""

    focal_mm: float = 0.0
    exposure_s: float = 0.0
    f_number: float = 0.0
    iso: float = 0.0
    lens: str = ""
    lens_make: str = ""


def libraw_metadata(path: Path) -> LibrawMetadata:
    """Return what LibRaw knows of a shot. Raises `PhotographError` if it refuses the file."""
    with _opened(path) as raw:
        if not hasattr(raw, "other"):  # rawpy before 0.26
            return LibrawMetadata()
        shot, lens = raw.other, raw.lens
        return LibrawMetadata(
            shot.focal_length, shot.shutter_speed, shot.aperture, shot.iso_speed, lens.model, lens.make
        )


def unknown_format(path: Path) -> str:
    """Return LibRaw's words for a file of a format that it does not know, or has no decoder for; empty for others,
    also damaged ones."""
    try:
        with rawpy.imread(str(path)) as raw:
            raw.unpack()
    except _UNKNOWN as error:
        return _words_of(error)
    except (rawpy.LibRawError, RuntimeError):
        return ""
    return ""


@contextmanager
def _opened(path: Path) -> Iterator[rawpy.RawPy]:
    try:
        refuse_cut_short(path)
        with rawpy.imread(str(path)) as raw:
            if raw.num_colors not in (1, 3):
                raise PhotographError(
                    f"{path.name}: a sensor of {raw.num_colors} colours; expected red, green and blue",
                    hint="convert it to TIFF with the maker's program",
                )
            yield raw
    except (rawpy.LibRawError, RuntimeError, NotImplementedError, cv2.error) as error:
        raise PhotographError(
            f"{path.name}: LibRaw cannot read this RAW file ({_words_of(error)})",
            hint=_CONVERT if isinstance(error, _UNKNOWN) and _has_raw_head(path) else BROKEN,
        ) from error


def _has_raw_head(path: Path) -> bool:
    with path.open("rb") as handle:
        return _HEADS.match(handle.read(16)) is not None


def _words_of(error: Exception) -> str:
    return str(error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error)


def _sensor(raw: rawpy.RawPy) -> Sensor:
    if raw.num_colors == 1:
        return "monochrome"
    if raw.raw_type != rawpy.RawType.Flat:
        return "demosaiced"
    side = _pattern(raw).shape[0]
    return "bayer" if side == 2 else "x-trans" if side == 6 else "mosaic"


def _mosaic(raw: rawpy.RawPy, path: Path) -> Mosaic:
    """Return the mosaic; `values` is LibRaw's own memory, for as long as the file is open."""
    values = raw.raw_image_visible
    pattern = _pattern(raw)
    levels = np.array(raw.black_level_per_channel or [0] * 4, np.float32)
    plane = black_plane(path, values.shape)
    black = levels[pattern] if plane is None else plane
    white = _white(raw, float(black.min()), path)
    return Mosaic(values, pattern, np.asarray(black, np.float32), white)


def _pattern(raw: rawpy.RawPy) -> NDArray[np.uint8]:
    """Return the pattern of the visible picture; rawpy's counts from the corner of the sensor, and knows no monochrome
    ones."""
    pattern = None if raw.num_colors == 1 else raw.raw_pattern
    if pattern is None:
        return np.zeros((1, 1), np.uint8)
    margins = (-raw.sizes.top_margin, -raw.sizes.left_margin)
    return np.asarray(np.roll(np.asarray(pattern), margins, axis=(0, 1)), np.uint8)


def _white(raw: rawpy.RawPy, black: float, path: Path) -> float:
    white = float(raw.white_level)
    if white - black < 1:
        raise PhotographError(
            f"{path.name}: white level {white:g} is not above black level {black:g}",
            hint="the file is damaged; take it out of the folder",
        )
    return white


def _scale_layers(raw: rawpy.RawPy, path: Path) -> None:
    """Scale black to 0 and white to 65535, of a file that has all its colours in every pixel; in place."""
    layers = raw.raw_image_visible
    levels = (raw.black_level_per_channel or [0] * 4)[: raw.num_colors]
    span = _white(raw, min(levels), path) - min(levels)
    for channel, level in enumerate(levels):
        layer = np.ascontiguousarray(layers[..., channel])
        scaled = cv2.multiply(cv2.subtract(layer, np.full(4, level)), np.full(4, FULL / span))
        scaled[layer >= raw.white_level] = FULL  # also where black is higher than in another channel
        layers[..., channel] = scaled


def _postprocessed(raw: rawpy.RawPy, demosaic: Demosaic, **options: Any) -> NDArray[np.uint16]:
    pixels = raw.postprocess(
        demosaic_algorithm=rawpy.DemosaicAlgorithm[demosaic.upper()],
        gamma=(1, 1),
        no_auto_bright=True,
        no_auto_scale=True,
        output_bps=16,
        use_camera_wb=False,
        user_wb=[1, 1, 1, 1],
        output_color=rawpy.ColorSpace.raw,
        user_flip=0,
        **options,
    )
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        pixels = np.repeat(pixels.reshape(*pixels.shape[:2], 1), 3, axis=2)
    return np.asarray(pixels, np.uint16)


def _as_shot(raw: rawpy.RawPy) -> tuple[float, float, float]:
    """Return the white balance of the shot, 1 for green; of daylight where the file does not say."""
    for factors in (raw.camera_whitebalance, raw.daylight_whitebalance):
        if factors and np.isfinite(factors[:3]).all() and min(factors[:3]) > 0:
            return factors[0] / factors[1], 1.0, factors[2] / factors[1]
    return 1.0, 1.0, 1.0


def _srgb_from_camera(raw: rawpy.RawPy, balance: Sequence[float]) -> NDArray[np.float64]:
    """Return white balance, then LibRaw's matrix to sRGB, whose rows sum to 1 so that white stays white."""
    matrix = np.array(raw.color_matrix, np.float64)[:, :3]
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-6:
        matrix = np.eye(3)
    return np.asarray(matrix @ np.diag(balance))
