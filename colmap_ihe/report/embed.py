"""Write pictures and clouds as text inside a page."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from colmap_ihe.report.contents import CameraPose, Cloud, Picture

_FAR_OUT = 30
"""Times the median distance from the middle: beyond are stray points, which would coarsen all others."""
_STEPS = 65535


def data_uri(picture: Picture) -> str:
    """Return the picture as a `data:` address."""
    return f"data:image/jpeg;base64,{as_base64(picture.jpeg)}"


def cloud_data(cloud: Cloud, cameras: Sequence[CameraPose]) -> Markup:
    """Return what the viewer reads, as JSON that may stand in a script element.

    `positions`: little-endian uint16 (N, 3), 0 at `low` and 65535 at `low` + `extent`, so within 1/131070 of the
    extent; `tints`: uint8 (N, 4), the colours and the grey; both in base64. Points that are not finite or lie far
    out are left out. Raises ValueError if the arrays of the cloud are not of one length.
    """
    if not len(cloud.positions) == len(cloud.colours) == len(cloud.grey):
        raise ValueError(
            f"a cloud of {len(cloud.positions)} positions, {len(cloud.colours)} colours and {len(cloud.grey)} greys"
        )
    kept = _near(cloud.positions)
    positions = np.asarray(cloud.positions, np.float64)[kept]
    low = positions.min(axis=0) if len(positions) else np.zeros(3)
    extent = np.ptp(positions, axis=0) if len(positions) else np.zeros(3)
    steps = np.round((positions - low) / np.where(extent > 0, extent, 1) * _STEPS)
    tints = np.concatenate([cloud.colours[kept], cloud.grey[kept][:, None]], axis=1)
    return script_json(
        {
            "positions": as_base64(steps.astype("<u2").tobytes()),
            "tints": as_base64(tints.astype(np.uint8).tobytes()),
            "low": low.tolist(),
            "extent": extent.tolist(),
            "metres_per_unit": cloud.metres_per_unit,
            "cameras": [
                {"name": c.name, "centre": _numbers(c.centre), "corners": [_numbers(k) for k in c.corners]}
                for c in cameras
                if np.isfinite(c.centre).all() and np.isfinite(c.corners).all()
            ],
        }
    )


def script_json(value: object) -> Markup:
    """Return JSON in which nothing can end the script element that holds it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _near(positions: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (N,) bool: the points that are finite and not far out."""
    finite = np.asarray(np.isfinite(positions).all(axis=1))
    if not finite.any():
        return finite
    away = np.full(len(positions), np.inf)
    away[finite] = np.linalg.norm(positions[finite] - np.median(positions[finite], axis=0), axis=1)
    near: NDArray[np.bool_] = away <= max(_FAR_OUT * float(np.median(away[finite])), 1e-12)
    return near


def as_base64(data: bytes) -> str:
    """Return bytes as text."""
    return base64.b64encode(data).decode("ascii")


def _numbers(values: NDArray[np.float32]) -> list[float]:
    return [float(f"{v:.6g}") for v in values]
