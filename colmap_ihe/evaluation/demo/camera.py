"""Take the demo's photographs: from radiance to a RAW file and the JPEG that the camera makes of the same shot."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from colmap_ihe.evaluation.demo.dng import write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif, jpeg_exif
from colmap_ihe.evaluation.demo.grid import F32
from colmap_ihe.evaluation.demo.views import FOCAL_LENGTH_35MM, DemoView
from colmap_ihe.grey.srgb import coded
from colmap_ihe.machine.files import write_bytes

BLACK, WHITE = 512, 16383
SENSOR_GAINS = (0.50, 1.00, 0.62)  # what a neutral surface gives in R, G, B, relative to green
_FULL_WELL_E = 40_000.0  # electrons at WHITE
_READ_NOISE_E = 5.0
_JPEG_QUALITY = 92

# CIE XYZ (D65) to linear sRGB, IEC 61966-2-1. The sensor sees sRGB's primaries, each with its own gain.
_RGB_FROM_XYZ = np.array(((3.2406, -1.5372, -0.4986), (-0.9689, 1.8758, 0.0415), (0.0557, -0.2040, 1.0570)))


def take_photograph(radiance: F32, view: DemoView, shot: int, folder: Path, seed: int) -> None:
    """Write `folder/STEM.dng` and `folder/STEM.jpg`, both of the size of `radiance`.

    `radiance` is (H, W, 3) linear RGB as rendered; the exposure of `view` is applied here.
    `shot` numbers the photograph: its time, and with `seed` its noise.
    """
    rng = np.random.default_rng((seed, 1, shot))
    exif = PhotoExif(
        taken=f"2016:06:21 10:{shot % 60:02d}:00",
        exposure_time_s=view.exposure_time_s,
        focal_length_35mm=FOCAL_LENGTH_35MM,
    )
    response = _sensor_response(radiance * np.float32(view.exposure), rng)
    write_dng(
        folder / f"{view.stem}.dng",
        _mosaic(response),
        black=BLACK,
        white=WHITE,
        as_shot_neutral=SENSOR_GAINS,
        colour_matrix=np.diag(SENSOR_GAINS) @ _RGB_FROM_XYZ,
        exif=exif,
    )
    balanced = np.asarray(np.clip(response / np.array(SENSOR_GAINS, np.float32), 0, 1), np.float32)
    picture = Image.fromarray(np.rint(coded(balanced) * 255).astype(np.uint8))
    jpeg = BytesIO()
    # Full-resolution chroma: halved, it would leak into the grey of the isoluminant panels.
    block = jpeg_exif(exif, view.width, view.height)
    picture.save(jpeg, "JPEG", quality=_JPEG_QUALITY, subsampling=0, exif=block)
    write_bytes(folder / f"{view.stem}.jpg", jpeg.getvalue())


def _sensor_response(exposed: F32, rng: np.random.Generator) -> F32:
    """Return (H, W, 3): linear camera RGB with photon and read noise, 0 black, 1 saturation; not white balanced."""
    electrons = exposed * np.array(SENSOR_GAINS, np.float32) * np.float32(_FULL_WELL_E)
    spread = np.sqrt(electrons + np.float32(_READ_NOISE_E**2))
    electrons += spread * rng.standard_normal(exposed.shape, dtype=np.float32)
    return np.asarray(np.minimum(electrons / np.float32(_FULL_WELL_E), 1), np.float32)


def _mosaic(response: F32) -> npt.NDArray[np.uint16]:
    """Return (H, W) raw values of an RGGB sensor: each pixel keeps one of its three responses."""
    plane = response[..., 1].copy()
    plane[0::2, 0::2] = response[0::2, 0::2, 0]
    plane[1::2, 1::2] = response[1::2, 1::2, 2]
    levels = np.rint(plane * np.float32(WHITE - BLACK)) + np.float32(BLACK)
    return np.asarray(np.clip(levels, 0, WHITE), np.uint16)
