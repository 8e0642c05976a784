"""Read from XMP where a drone with RTK took a photograph, and how well it knew.

DJI's names, which other makers write too: `RtkFlag` is 50 for a fixed solution, others are metres off like any GPS;
`RtkStdLon`, `RtkStdLat` and `RtkStdHgt` are standard deviations in metres.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.machine.files import open_file

_MOST = 256 * 1024  # bytes from the beginning, where XMP is
_FIXED = 50
_VALUE = rb"drone-dji:%s(?:\s*=\s*[\"']|>)\s*([+-]?[0-9.]+)"
_LEAST_M = 0.01  # standard deviation: RTK is not better than that


@dataclass(frozen=True)
class RtkPosition:
    """Hold longitude and latitude in degrees, the height in metres, and their standard deviation in metres."""

    longitude: float
    latitude: float
    height_m: float
    accuracy_m: float


def rtk_position(photograph: Path) -> RtkPosition | None:
    """Return the fixed RTK position that the XMP of a file tells, None where there is none or the file cannot be
    read."""
    try:
        with open_file(photograph) as handle:
            content = handle.read(_MOST)
    except OSError:
        return None
    if b"drone-dji:RtkFlag" not in content or _number(content, b"RtkFlag") != _FIXED:
        return None
    names = (b"GpsLongitude", b"GpsLatitude", b"AbsoluteAltitude")
    longitude, latitude, height = (_number(content, name) for name in names)
    deviations = [_number(content, name) for name in (b"RtkStdLon", b"RtkStdLat", b"RtkStdHgt")]
    if any(map(math.isnan, (longitude, latitude, height))) or (latitude, longitude) == (0, 0):
        return None
    known = [deviation for deviation in deviations if deviation > 0]
    return RtkPosition(longitude, latitude, height, max([_LEAST_M, *known]))


def _number(content: bytes, name: bytes) -> float:
    found = re.search(_VALUE % name, content)
    try:
        return float(found[1]) if found else math.nan
    except ValueError:
        return math.nan
