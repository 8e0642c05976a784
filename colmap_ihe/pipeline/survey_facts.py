"""State a model in figures, as a surveyor asks for it: photographs, dates, GPS, what a pixel shows, size, memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.observations import Float64, Observations
from colmap_ihe.machine.memory import in_bytes
from colmap_ihe.machine.words import counted
from colmap_ihe.photographs.exif.blocks import is_place
from colmap_ihe.report.truth_words import truth_rows

_Row = tuple[str, str]


@dataclass(frozen=True)
class Measures:
    """Hold what is measured in a sparse model: `gsd` (N,), the side of what a pixel of each photograph shows, nan where
    it sees no point, and the `extent` (3,) across, up and deep, in units of the model; `metric`: these are metres."""

    gsd: Float64
    extent: NDArray[np.floating]
    metric: bool

    @property
    def gsd_mm(self) -> float | None:
        """Return what a pixel shows in the median of the photographs, None without metres."""
        return 1000 * float(np.nanmedian(self.gsd)) if self.metric and np.isfinite(self.gsd).any() else None


def pixel_sizes(seen: Observations) -> Float64:
    """Return (N,): the side of what a pixel shows at the median depth of the points that each photograph sees."""
    depths, sizes = seen.depths, np.full(len(seen.names), np.nan)
    for number, focal in enumerate(seen.focal_px):
        mine = depths[seen.block.image == number]
        if len(mine):
            sizes[number] = float(np.median(mine)) / focal
    return sizes


def survey_facts(
    summary: Mapping[str, Any],
    captures: Mapping[str, Any],
    measures: Measures,
    fixes: Sequence[tuple[float, float, float]],
) -> list[_Row]:
    """Return the rows of the block: name and value, those that something is known of. `fixes`: latitude and longitude
    in degrees, and height in metres."""
    rows = [
        ("photographs", _photographs(summary)),
        ("taken", taken_in_words(captures.get("taken", {}).values(), captures["images"])),
        ("GPS", _fixes_in_words(fixes, summary["images"])),
        ("what a pixel shows", _pixel_in_words(measures)),
        ("size of the model", _size_in_words(measures)),
        ("points", f"{summary['points3D']:,}"),
        ("dense cloud", _dense(summary)),
        ("mesh", _mesh(summary)),
        *truth_rows(summary.get("truth", {})),
        ("memory", _memory(summary["peak_memory_bytes"])),
    ]
    return [(name, value) for name, value in rows if value]


def _photographs(summary: Mapping[str, Any]) -> str:
    left_out = len(summary["left_out"])
    out = f", {left_out} left out" if left_out else ""
    return f"{summary['registered_images']} registered of {summary['images']}{out}"


def taken_in_words(taken: Sequence[str] | Any, images: int) -> str:
    """Return when photographs were taken, from dates as EXIF writes them; empty where none says it."""
    moments = []
    for text in taken:
        with suppress(ValueError):
            moments.append(datetime.strptime(text[:19], "%Y:%m:%d %H:%M:%S"))
    if not moments:
        return ""
    first, last = min(moments), max(moments)
    days = len({moment.date() for moment in moments})
    if days > 1:
        words = f"{first:%Y-%m-%d} to {last:%Y-%m-%d}, on {days} days"
    elif f"{first:%H:%M}" == f"{last:%H:%M}":
        words = f"{first:%Y-%m-%d %H:%M}"
    else:
        words = f"{first:%Y-%m-%d}, {first:%H:%M} to {last:%H:%M}"
    return words if len(moments) == images else f"{words}, as {len(moments)} of {images} say"


def fixes_of(database: Path) -> list[tuple[float, float, float]]:
    """Return the GPS fixes of the photographs in a database: latitude, longitude, height."""
    with pycolmap.Database.open(database) as opened:
        priors = [prior for prior in opened.read_all_pose_priors() if prior.has_position()]
    places = [(float(p.position[0]), float(p.position[1]), float(p.position[2])) for p in priors]
    return [place for place in places if is_place(*place)]


def _fixes_in_words(fixes: Sequence[tuple[float, float, float]], images: int) -> str:
    if not fixes:
        return ""
    latitude, longitude, _ = np.median(fixes, axis=0)
    low, high = np.min(fixes, axis=0)[2], np.max(fixes, axis=0)[2]
    north, east = "N" if latitude >= 0 else "S", "E" if longitude >= 0 else "W"
    where = f"about {abs(latitude):.5f}° {north}, {abs(longitude):.5f}° {east}"
    height = f"{low:.0f} m" if round(low) == round(high) else f"{low:.0f} to {high:.0f} m"
    return f"{counted(len(fixes), 'photograph')} of {images}, {where}, at heights of {height}"


def _pixel_in_words(measures: Measures) -> str:
    sizes = measures.gsd[np.isfinite(measures.gsd)]
    longest = float(np.max(measures.extent, initial=0.0))
    if not len(sizes) or not longest:
        return ""
    median, low, high = float(np.median(sizes)), float(sizes.min()), float(sizes.max())
    if measures.metric:
        return f"{1000 * median:.3g} mm, by photograph {1000 * low:.3g} to {1000 * high:.3g} mm"
    parts = [f"1/{_rounded(longest / value):,}" for value in (median, low, high)]
    return f"{parts[0]} of the model's longest side, by photograph {parts[1]} to {parts[2]}"


def _rounded(value: float) -> int:
    """Return a number of three digits and noughts."""
    return int(float(f"{value:.3g}"))


def _size_in_words(measures: Measures) -> str:
    across, up, deep = (float(side) for side in measures.extent)
    longest = max(across, up, deep)
    if not longest:
        return ""
    if measures.metric:
        return f"{across:.3g} m across, {up:.3g} m high, {deep:.3g} m deep (90 % of the points)"
    shares = ", ".join(
        f"{side / longest:.2f} {name}" for side, name in ((across, "across"), (up, "high"), (deep, "deep"))
    )
    return f"{shares}, in shares of its longest side (90 % of the points)"


def _dense(summary: Mapping[str, Any]) -> str:
    if not summary["dense_points"]:
        return ""
    coverage = summary["dense_pixels_with_depth_percent"]
    share = f", depth in {coverage:.0f} % of the pixels" if coverage is not None else ""
    return f"{summary['dense_points']:,} points ({summary['dense_backend']}){share}"


def _mesh(summary: Mapping[str, Any]) -> str:
    if summary["mesh_faces"] is None:
        return ""
    size = summary["mesh_texture"]
    look = f"a texture of {size[0]}x{size[1]}" if size else "vertex colours"
    return f"{summary['mesh_faces']:,} triangles with {look}"


def _memory(most: int | None) -> str:
    return f"at most {in_bytes(most)} in one process" if most else ""
