"""Show the relief of a drawing: hillshade, deviation from the plane in colours, and contour lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, Float64, UInt8
from colmap_ihe.drawings.grid import PixelGrid, nice_size
from colmap_ihe.drawings.lines import Line

_SUN = np.array((-0.5, 0.5, 0.7071))  # from the upper left, half way up
_PALE = (225, 225, 225)
# From far behind over on the plane to far out: blue, white, red, told apart by the colour-blind too.
_COLOURS = np.array(
    ((33, 60, 140), (116, 173, 209), (247, 247, 247), (244, 140, 80), (165, 15, 38)), np.float64
)
_TINTS = 1025  # between the first colour and the last
_NEAR = 0.02  # of the extent of a drawing: what is within may deviate, and what is beyond is something else
_STEPS = 4  # contour lines on each side of the plane
_LEVELS = 20  # contour lines over all heights of a plan
_SHORTEST = 8  # points of a contour line


def hillshade(out: Float32, pixel: float) -> UInt8:
    """Return (H, W) uint8: a relief (H, W), nan where there is none, lit from the upper left; white there."""
    filled = np.nan_to_num(out)
    across = cv2.Sobel(filled, cv2.CV_32F, 1, 0, scale=1 / 8) / pixel
    down = cv2.Sobel(filled, cv2.CV_32F, 0, 1, scale=1 / 8) / pixel
    x, y, z = _SUN
    light = (z - x * across + y * down) / np.sqrt(1 + across**2 + down**2)
    shade = np.clip(40 + 215 * light / 1.2, 0, 255)
    return np.asarray(np.where(np.isnan(out), 255, shade).astype(np.uint8))


def deviation_range(out: Float32, extent: float) -> float:
    """Return up to where a map of deviations tells them, in units of the model: about three times the RMS of what lies
    near the plane, nice to read."""
    near = out[np.abs(out) < _NEAR * extent]
    rms = float(np.sqrt(np.mean(near.astype(np.float64) ** 2))) if near.size else _NEAR * extent
    return nice_size(max(3 * rms, 1e-4 * extent))


def deviation_colours(out: Float32, most: float) -> UInt8:
    """Return (H, W, 3) uint8: blue behind the plane, white on it, red in front; grey beyond `most`, white without a
    surface."""
    places = np.linspace(0, len(_COLOURS) - 1, _TINTS)
    known = [np.interp(places, np.arange(len(_COLOURS)), _COLOURS[:, k]) for k in range(3)]
    table = np.concatenate((np.rint(np.stack(known, axis=1)), [_PALE, (255, 255, 255)])).astype(np.uint8)
    share = (np.clip(np.nan_to_num(out) / np.float32(most), -1, 1) + 1) / 2 * (_TINTS - 1)
    index = np.rint(share).astype(np.uint16)
    index[np.abs(out) > most] = _TINTS
    index[np.isnan(out)] = _TINTS + 1
    return np.asarray(table[index], np.uint8)


def legend_stops(most: float) -> list[tuple[float, tuple[int, int, int]]]:
    """Return the deviations of the legend with their colours, from the farthest behind to the farthest out."""
    stops = np.linspace(-most, most, len(_COLOURS))
    return [(float(s), (int(c[0]), int(c[1]), int(c[2]))) for s, c in zip(stops, _COLOURS, strict=True)]


def with_legend(picture: UInt8, most: float, unit: str) -> UInt8:
    """Return a map of deviations with its legend below it; `most` in `unit`."""
    height, width = 70, picture.shape[1]
    strip = np.full((height, width, 3), 255, np.uint8)
    left, right = 20, max(30, min(width - 20, 620))
    values = np.linspace(-most, most, right - left, dtype=np.float32)[None]
    strip[8:28, left:right] = deviation_colours(np.repeat(values, 20, axis=0), most)
    cv2.rectangle(strip, (left, 8), (right, 28), (0, 0, 0), 1)
    for value, _ in legend_stops(most):
        x = left + int((value + most) / (2 * most) * (right - left))
        text = f"{value:+g}" if value else "0"
        (length, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
        cv2.putText(
            strip, text, (x - length // 2, 44), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA
        )
    words = f"{unit} in front (+) or behind (-); grey: farther"
    cv2.putText(strip, words, (left, 62), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate((picture, strip))


def contour_levels(out: Float32, most: float | None) -> list[float]:
    """Return the levels of contour lines: four on each side of the plane up to `most`, or over all heights (None)."""
    if most is not None:
        step = most / _STEPS
        return [k * step for k in range(-_STEPS, _STEPS + 1) if k]
    known = out[np.isfinite(out)]
    if not known.size:
        return []
    low, high = (float(v) for v in np.percentile(known, (1, 99)))
    step = nice_size(max((high - low) / _LEVELS, 1e-6))
    return [k * step for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def contour_lines(out: Float32, grid: PixelGrid, levels: Sequence[float]) -> dict[float, list[Line]]:
    """Return the contour lines of a relief (H, W) on the pixels of `grid`, by level; (N, 2) across and up each."""
    if min(out.shape) < 2:
        return {level: [] for level in levels}
    values = np.ma.masked_invalid(out.astype(np.float64))
    generator = _generator(grid.across(), grid.up(), values)
    return {level: _lines(generator.lines(level), grid.pixel) for level in levels}


def outline(covered: Bool, grid: PixelGrid, least: float) -> list[Line]:
    """Return the outline of what a drawing shows, with its holes, but for parts of less than `least` area; (N, 2)
    across and up each, along the edges of pixels."""
    framed = np.pad(covered, 1).astype(np.float64)
    across = np.concatenate(([grid.left - grid.pixel / 2], grid.across(), [grid.right + grid.pixel / 2]))
    up = np.concatenate(([grid.top + grid.pixel / 2], grid.up(), [grid.bottom - grid.pixel / 2]))
    found = _generator(across, up, framed).lines(0.5)
    return [line for line in _lines(found, grid.pixel) if _area(line.points) >= least]


def _generator(across: Float64, up: Float64, values: Float64) -> Any:
    import contourpy  # here, since it may be missing

    return contourpy.contour_generator(across, up, values, name="serial")


def _lines(found: Sequence[Float64], pixel: float) -> list[Line]:
    """Return lines, simplified by less than half a pixel."""
    lines = []
    for points in found:
        if len(points) < _SHORTEST:
            continue
        closed = bool(np.allclose(points[0], points[-1]))
        shifted = (points - points[0]).astype(np.float32)
        kept = cv2.approxPolyDP(shifted[:, None], 0.4 * pixel, closed)[:, 0] + points[0]
        if len(kept) > 1:
            lines.append(Line(np.asarray(kept, np.float64), closed))
    return lines


def _area(points: Float64) -> float:
    x, y = (points - points[0]).T
    return float(abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2)
