"""Work out the numbers behind the charts of a page; its templates draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.photographs.png import encode_png
from colmap_ihe.report.contents import Contents, Grey
from colmap_ihe.report.embed import as_base64
from colmap_ihe.report.survey_contents import Residuals

WIDTH, HEIGHT = 640, 200  # of a chart, in units of its drawing
_HIGHEST_SHARE = 99.5
"""Percentile of the tones that a chart reaches to: black and white borders stand out of it."""
_BARS = 20  # numbers of images with a bar of their own
_INK = (46, 110, 178)  # R, G, B of the match picture: seen on dark and on light
_LEAST_SIDE = 320


@dataclass(frozen=True)
class TonesChart:
    """Hold the outlines of two histograms as SVG paths, `rec709` empty without one; `clipped` where a tone stands out
    of the chart."""

    chosen: str
    rec709: str
    clipped: bool


@dataclass(frozen=True)
class Bar:
    """Describe a bar of a chart, in units of its drawing. `share` of all points, in 0..1."""

    label: str
    points: int
    share: float
    left: float
    width: float
    height: float


@dataclass(frozen=True)
class MatchPicture:
    """Show the matches between photographs, as a PNG picture in a `data:` address, with its highest count."""

    uri: str
    side: int
    most: int
    linked_pairs: int


def tones_chart(grey: Grey) -> TonesChart | None:
    """Return the chart of the tones, None where the histograms are missing."""
    given = [tones for tones in (grey.tones_chosen, grey.tones_rec709) if len(tones)]
    if len(grey.tones_chosen) < 2 or len({len(tones) for tones in given}) != 1:
        return None
    tones = np.nan_to_num(np.array(given, np.float64))
    top = float(np.percentile(tones, _HIGHEST_SHARE)) or float(tones.max()) or 1.0
    top *= 1.08
    outlines = [_outline(np.minimum(each / top, 1)) for each in tones]
    return TonesChart(outlines[0], outlines[1] if len(outlines) > 1 else "", bool((tones > top).any()))


def residuals_chart(residuals: Residuals) -> list[Bar]:
    """Return a bar for each step of the residuals; each fifth is labelled by where it begins, in pixels."""
    most, total, step = max(residuals.counts, default=0), sum(residuals.counts), WIDTH / len(residuals.counts)
    if not most:
        return []
    last = len(residuals.counts) - 1
    return [
        Bar(
            f"{number * residuals.step_px:g}{'+' if number == last else ''}",
            count,
            count / total,
            number * step + 0.1 * step,
            0.8 * step,
            HEIGHT * count / most,
        )
        for number, count in enumerate(residuals.counts)
    ]


def tracks_chart(points_by_images: Mapping[int, int]) -> list[Bar]:
    """Return a bar for each number of images from the least, the last for more images too."""
    if not points_by_images or not any(points_by_images.values()):
        return []
    first, longest = min(points_by_images), max(points_by_images)
    last = min(longest, first + _BARS - 1)
    counts = {images: points_by_images.get(images, 0) for images in range(first, last + 1)}
    counts[last] += sum(points for images, points in points_by_images.items() if images > last)
    total, most = sum(counts.values()), max(counts.values())
    step, bars = WIDTH / len(counts), []
    for i, (images, points) in enumerate(counts.items()):
        label = f"{images}+" if images == last < longest else str(images)
        left, width, height = i * step + 0.1 * step, 0.8 * step, HEIGHT * points / most
        bars.append(Bar(label, points, points / total, round(left, 2), round(width, 2), round(height, 2)))
    return bars


def match_picture(matches: NDArray[np.int64]) -> MatchPicture | None:
    """Draw a square a pair, the fuller the more matches, as the square root. None where there are none."""
    both = np.maximum(matches, matches.T).astype(np.float64)
    np.fill_diagonal(both, 0)
    if not both.size or both.max() <= 0:
        return None
    strength = np.sqrt(np.maximum(both, 0) / both.max())
    picture = np.empty((*both.shape, 4), np.uint8)
    picture[..., :3] = _INK
    picture[..., 3] = np.round(255 * strength)
    times = max(1, -(-_LEAST_SIDE // len(both)))
    picture = picture.repeat(times, axis=0).repeat(times, axis=1)
    uri = f"data:image/png;base64,{as_base64(encode_png(picture))}"
    return MatchPicture(uri, len(picture), int(both.max()), int(np.count_nonzero(np.triu(both))))


def partners(contents: Contents) -> dict[str, int]:
    """Count the others that each photograph has verified matches with, by name; empty without matches."""
    if contents.matches is None or len(contents.matches) != len(contents.photographs):
        return {}
    linked = (contents.matches > 0) | (contents.matches.T > 0)
    np.fill_diagonal(linked, False)
    return {p.name: int(n) for p, n in zip(contents.photographs, linked.sum(axis=1), strict=True)}


def duration(seconds: float) -> str:
    """Write seconds as a person reads them."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def _outline(heights: NDArray[np.float64]) -> str:
    """Return a closed path of steps, from (W,) heights in 0..1."""
    step = WIDTH / len(heights)
    tops = [f"L{i * step:.1f} {HEIGHT * (1 - h):.1f}H{(i + 1) * step:.1f}" for i, h in enumerate(heights)]
    return f"M0 {HEIGHT}{''.join(tops)}V{HEIGHT}Z"
