"""Move the edges of a depth map to where the photographs have them.

A window that reaches across an edge looks like the side with more contrast, mostly the nearer one. So the surface in
front comes out some pixels too wide, and of what is behind it a rim is missing or has the depth of what is in front.
Here both surfaces are continued to every pixel beside an edge, from windows that lie wholly on either side, and the
pixel takes the one at whose depth it looks alike in the sources that see it best: those on one side of the edge see
what those on the other do not. Of the pixels around, those count that are as bright as the pixel itself: beside a thin
thing most of them are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.dense.camera import Bool, Float32
from colmap_ihe.dense.stereo.merge import filled
from colmap_ihe.dense.stereo.normals import fitted_planes
from colmap_ihe.dense.stereo.refine import project, sampled
from colmap_ihe.dense.stereo.strips import overwrite
from colmap_ihe.dense.stereo.views import StereoView

# Measured with benchmarks/dense_truth.py.
_REACH_PX = 6  # from an edge: as far as windows of matching and refinement put it wrong
_RADIUS_PX = 4  # half of the window of a surface
_AWAY_PX = 12  # from a pixel to the middle of such a window: beyond `_REACH_PX`
_MISFIT = 0.9  # of a surface in its window, in `one_pixel`: an edge is in a window with a larger one
_STEP = 3.0, 0.015  # of an edge at least: in `one_pixel`, and relative
_ALIKE_PX = 2  # half of the window that is compared
_ALIKE_VARIANCE = 400.0  # of grey levels in it, from which brightness tells the two sides of an edge apart
_LIGHT_PX = 15  # half of the window over which a source may be brighter
_MOST_BRIGHTER = 25.0  # than usual in a pair, in levels
_MOST_LEVELS = 10.0  # larger differences of grey values count as this
_BEST_SOURCES = 2
# Of the present difference, to change sides: windows err towards the nearer.
_TO_FARTHER, _TO_NEARER = 1.2, 0.8
# A pixel without depth takes one up to such a difference, in levels, or so many times the usual one beside edges.
_IN_HOLES_LEVELS, _IN_HOLES = 4.0, 1.6


@dataclass(frozen=True)
class _Pixels:
    """List pixels as 2-D arrays, which OpenCV samples: `rows` and `columns`, of an image of `shape`, and their `number`
    there, row by row."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    number: NDArray[np.intp]
    shape: tuple[int, int]

    def of(self, image: NDArray[np.float32]) -> Float32:
        """Return the values of the pixels in an image (H, W)."""
        return np.asarray(image.take(self.number))

    def mean_around(self, values: Float32, radius_px: int) -> Float32:
        """Return the mean of the values of the pixels, over windows; pixels that are not listed count as 0."""
        image = np.zeros(self.shape, np.float32)
        image.ravel()[self.number] = values
        return self.of(np.asarray(cv2.blur(image, (2 * radius_px + 1,) * 2), np.float32))


def sharpened(
    reference: StereoView, sources: Sequence[StereoView], inverse_depth: Float32, one_pixel: float
) -> Float32:
    """Return `inverse_depth` (H, W) float32, 0 for none, of `reference` with the surface beside each edge that
    `sources` confirm; pixels there without depth take one where it fits as well. `one_pixel` is the change of inverse
    depth that moves a match by one pixel."""
    nearest, farthest = _extremes(inverse_depth)
    beside = (nearest > 0) & _is_step(nearest, farthest, one_pixel)
    if reference.mask_u8 is not None:
        beside &= reference.mask_u8 > 0
    if not beside.any():
        return inverse_depth
    pixels = _listed(beside)
    present = pixels.of(filled(inverse_depth))
    nearer, farther = _surfaces(inverse_depth, pixels, present, one_pixel)
    thin = pixels.of(nearest)  # what is thinner than a window has its depth from nearby
    nearer = np.where(_is_step(thin, nearer, one_pixel), thin, nearer)
    held = pixels.of(inverse_depth) > 0
    depths = (present, nearer, farther)
    now, at_nearer, at_farther = _differences(reference, sources, pixels, held, depths)
    is_near = np.abs(present - nearer) < np.abs(present - farther)
    two_sided = _is_step(nearer, farther, one_pixel) & beside[pixels.rows, pixels.columns]
    to_farther = is_near & (at_farther < _TO_FARTHER * now)
    to_nearer = ~is_near & (at_nearer < _TO_NEARER * now)
    chosen = np.where(to_farther, farther, np.where(to_nearer, nearer, pixels.of(inverse_depth)))
    most = max(_IN_HOLES_LEVELS, _IN_HOLES * float(np.median(now[held]))) if held.any() else _IN_HOLES_LEVELS
    fits = np.minimum(at_nearer, at_farther) <= most
    in_hole = np.where(fits, np.where(at_farther < at_nearer, farther, nearer), 0)
    result = inverse_depth.copy()
    changed = np.where(held, chosen, in_hole)
    result[pixels.rows[two_sided], pixels.columns[two_sided]] = changed[two_sided]
    return result


def _is_step(nearer: Float32, farther: Float32, one_pixel: float) -> Bool:
    """Tell where two inverse depths differ as those beside an edge."""
    return np.asarray(nearer - farther > np.maximum(np.float32(_STEP[0] * one_pixel), _STEP[1] * farther))


def _extremes(inverse_depth: Float32) -> tuple[Float32, Float32]:
    """Return the largest and the smallest inverse depth within `_REACH_PX`; 0 and far more than any without one."""
    around = np.ones((2 * _REACH_PX + 1,) * 2, np.uint8)
    without_holes = np.where(inverse_depth > 0, inverse_depth, np.float32(np.finfo(np.float32).max))
    largest, smallest = cv2.dilate(inverse_depth, around), cv2.erode(without_holes, around)
    return np.asarray(largest, np.float32), np.asarray(smallest, np.float32)


def _listed(beside: Bool) -> _Pixels:
    """List the pixels `beside` edges, and those that their windows reach."""
    around = np.ones((2 * _ALIKE_PX + 1,) * 2, np.uint8)
    rows, columns = np.nonzero(cv2.dilate(beside.astype(np.uint8), around))
    width = min(256, len(rows))
    places = np.minimum(np.arange(-(-len(rows) // width) * width), len(rows) - 1).reshape(-1, width)
    rows, columns, shape = rows[places], columns[places], (beside.shape[0], beside.shape[1])
    return _Pixels(rows, columns, rows * shape[1] + columns, shape)


def _surfaces(
    inverse_depth: Float32, pixels: _Pixels, present: Float32, one_pixel: float
) -> tuple[Float32, Float32]:
    """Return the nearest and the farthest of the surfaces around each pixel, continued to it; `present` without one."""
    planes = [values.ravel() for values in fitted_planes(inverse_depth, _RADIUS_PX)]
    height, width = pixels.shape
    nearer, farther = np.zeros_like(present), np.full_like(present, np.inf)
    offsets = [(x, y) for y in (-_AWAY_PX, 0, _AWAY_PX) for x in (-_AWAY_PX, 0, _AWAY_PX) if x or y]
    for x, y in offsets:
        rows, columns = pixels.rows + y, pixels.columns + x
        outside = (rows < 0) | (rows >= height) | (columns < 0) | (columns >= width)
        windows = pixels.number + (y * width + x)  # of those outside, any
        value, slope_x, slope_y, misfit = (each.take(windows, mode="clip") for each in planes)
        continued = value - slope_x * x - slope_y * y
        sound = ~outside & (misfit < (_MISFIT * one_pixel) ** 2) & (continued > 0)
        overwrite(nearer, np.maximum(nearer, continued), sound)
        overwrite(farther, np.minimum(farther, continued), sound)
    return np.where(nearer > 0, nearer, present), np.where(np.isfinite(farther), farther, present)


def _differences(
    reference: StereoView,
    sources: Sequence[StereoView],
    pixels: _Pixels,
    held: Bool,
    inverse_depths: Sequence[Float32],
) -> list[Float32]:
    """Return, for each of the depths of the pixels, the mean difference of grey values around in the sources that fit
    best.

    How much brighter the reference is than a source is known from where the first depth is `held`. The mean is that of
    pixels as bright as the one itself: by a line through differences and grey values (He et al. 2013, "Guided image
    filtering").
    """
    u, v = pixels.columns + np.float32(0.5), pixels.rows + np.float32(0.5)
    grey = reference.grey_u8[pixels.rows, pixels.columns].astype(np.float32)
    usual = pixels.mean_around(grey, _ALIKE_PX)
    variance = pixels.mean_around(grey * grey, _ALIKE_PX) - usual * usual
    apart = (grey - usual) / (variance + _ALIKE_VARIANCE)
    by_source: list[list[Float32]] = [[] for _ in inverse_depths]
    for source in sources:
        brighter = None
        for differences, inverse_depth in zip(by_source, inverse_depths, strict=True):
            at = project(reference, source, u, v, inverse_depth)
            difference = grey - sampled(source, at.x, at.y)
            if brighter is None:
                brighter = _brighter(difference, at.seen & held, pixels)
            levels = np.where(at.seen, np.minimum(np.abs(difference - brighter), _MOST_LEVELS), _MOST_LEVELS)
            levels = levels.astype(np.float32)
            mean = pixels.mean_around(levels, _ALIKE_PX)
            together = pixels.mean_around(levels * grey, _ALIKE_PX) - mean * usual
            differences.append(np.maximum(mean + apart * together, 0))
    best = slice(0, _BEST_SOURCES)
    return [np.asarray(np.sort(np.stack(each), axis=0)[best].mean(axis=0)) for each in by_source]


def _brighter(difference: Float32, matched: Bool, pixels: _Pixels) -> Float32:
    """Return how many levels the reference is brighter than a source around each pixel, from the differences of those
    `matched`, of which a few have wrong depths."""
    usual = np.float32(np.median(difference[matched])) if matched.any() else np.float32(0)
    alike = matched & (np.abs(difference - usual) < _MOST_BRIGHTER)
    weight = pixels.mean_around(alike.astype(np.float32), _LIGHT_PX)
    local = pixels.mean_around((difference - usual) * alike, _LIGHT_PX) / np.maximum(weight, np.float32(1e-6))
    return np.asarray(usual + local, np.float32)
