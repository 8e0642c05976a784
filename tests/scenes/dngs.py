"""DNGs of every kind of sensor, for tests: a directory of tags and pixels, packed as the file says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import TiffTags
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from colmap_ihe.evaluation.demo.dng import write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif

CFA, LINEAR_RAW = 32803, 34892
_HEADER = b"II*\0\x08\0\0\0"

XTRANS = np.array(
    [list("GBGGRG"), list("RGRBGB"), list("GBGGRG"), list("GRGGBG"), list("BGBRGR"), list("GRGGBG")]
)


GAINS = {"R": 0.45, "G": 1.0, "B": 0.7}
"""What a sensor sees of grey light in each colour, as shares of green."""


def light(height: int, width: int) -> NDArray[np.float64]:
    """(height, width) in 0..1: a grey scene so smooth that demosaicing has nothing to guess."""
    y, x = np.mgrid[0:height, 0:width]
    return np.asarray(0.45 + 0.25 * np.sin(x / 40) + 0.15 * np.cos(y / 30))


def write_kind(
    path: Path,
    values: NDArray[np.uint16],
    *,
    pattern: NDArray[Any] | None = None,
    bits: int = 16,
    white: int | None = None,
    black: tuple[float, ...] = (0,),
    repeat: tuple[int, int] = (1, 1),
    delta_h: NDArray[np.float64] | None = None,
    delta_v: NDArray[np.float64] | None = None,
    active: tuple[int, int, int, int] | None = None,
    model: str = "Test",
    tags: Mapping[int, Any] | None = None,
) -> None:
    """values: (H, W) of a mosaic or (H, W, samples), in `bits` bits. `pattern`: letters of the cell of a mosaic;
    without it the file is linear (3 samples) or monochrome (1). `active`: top, left, bottom, right. `tags`: more of
    them, or others."""
    height, width = values.shape[:2]
    samples = values.shape[2] if values.ndim == 3 else 1
    packed = _packed(values.reshape(height, -1), bits)
    colours = 1 if pattern is None and samples == 1 else 3
    entries: list[tuple[int, int, Any]] = [
        (254, TiffTags.LONG, 0), (256, TiffTags.LONG, width), (257, TiffTags.LONG, height),
        (258, TiffTags.SHORT, (bits,) * samples), (259, TiffTags.SHORT, 1),
        (262, TiffTags.SHORT, LINEAR_RAW if pattern is None else CFA),
        (271, TiffTags.ASCII, "Test"), (272, TiffTags.ASCII, model), (273, TiffTags.LONG, 0),
        (277, TiffTags.SHORT, samples), (278, TiffTags.LONG, height), (279, TiffTags.LONG, len(packed)),
        (284, TiffTags.SHORT, 1), (50706, TiffTags.BYTE, bytes((1, 4, 0, 0))),
        (50707, TiffTags.BYTE, bytes((1, 1, 0, 0))), (50708, TiffTags.ASCII, f"Test {model}"),
        (50713, TiffTags.SHORT, repeat),
        (50714, TiffTags.RATIONAL, tuple(float(b) for b in black)),
        (50717, TiffTags.LONG, (1 << bits) - 1 if white is None else white),
    ]  # fmt: skip
    if colours == 3:
        entries.append((50721, TiffTags.SIGNED_RATIONAL, tuple(np.eye(3).ravel().tolist())))
        entries.append((50728, TiffTags.RATIONAL, (0.5, 1.0, 0.6)))
        entries.append((50778, TiffTags.SHORT, 21))
    if pattern is not None:
        entries.append((33421, TiffTags.SHORT, pattern.shape))
        entries.append((33422, TiffTags.BYTE, bytes("RGB".index(c) for c in pattern.ravel())))
    for tag, delta in ((50715, delta_h), (50716, delta_v)):
        if delta is not None:
            entries.append((tag, TiffTags.SIGNED_RATIONAL, tuple(delta.tolist())))
    if active is not None:
        entries.append((50829, TiffTags.LONG, active))
    directory = ImageFileDirectory_v2()
    for tag, kind, value in entries:
        directory.tagtype[tag] = kind
        directory[tag] = value
    directory.update(tags or {})
    path.write_bytes(_HEADER + directory.tobytes(len(_HEADER)) + packed)


def shoot(path: Path, mosaic: NDArray[np.uint16], **changes: Any) -> None:
    """Write a DNG as the demo's camera does, (H, W), by default of black 512 and white 16383."""
    path.parent.mkdir(parents=True, exist_ok=True)
    camera: dict[str, Any] = {"black": 512, "white": 16383, "as_shot_neutral": (0.5, 1.0, 0.6)}
    write_dng(path, mosaic, **(camera | {"colour_matrix": np.eye(3), "exif": PhotoExif()} | changes))


def _packed(rows: NDArray[np.uint16], bits: int) -> bytes:
    """Most significant bit first where a sample is not a whole number of bytes (TIFF 6.0, FillOrder 1)."""
    if bits == 16:
        return rows.astype("<u2").tobytes()
    places = np.arange(bits - 1, -1, -1)
    ones = (rows[..., None] >> places) & 1
    return np.packbits(ones.reshape(len(rows), -1).astype(np.uint8), axis=1).tobytes()
