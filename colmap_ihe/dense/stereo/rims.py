"""Drop the rims of plain areas that have the depth of what stands before them, as of the sky beside a building.

A window beside an outline shows the outline, which matches at the depth of what it belongs to; the plain area in the
window shows nothing. So its rim gets the depth of the outline, be it a white wall of the same building, where that is
right, or the sky. By one window the two look the same. But a wall has a grain, fainter than the noise of a pixel, that
some hundred pixels together show: with the rim's depth continued into the area, the photographs of a wall correlate
there, those of the sky and of a wall farther away do not. So it is with a whole bright plain area whose noise was taken
for texture: it has the depth of what is around it, and goes where no grain agrees. A dark one, as a slate roof in the
shade, keeps its depth: compressed photographs leave it no grain.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, UInt8
from colmap_ihe.dense.stereo.merge import filled
from colmap_ihe.dense.stereo.refine import project, sampled
from colmap_ihe.dense.stereo.strips import strips
from colmap_ihe.dense.stereo.views import StereoView

# Measured with benchmarks/dense_truth.py and benchmarks/dense.py.
_REACH_PX = 6  # of a rim
_AREA_PX = 1000  # smaller plain areas are gaps of a surface
_PLAIN_PX, _PLAIN_LEVELS = 5, 3.0  # standard deviation in windows of so many pixels
_ALIKE_LEVELS, _ALIKE_NOISE = 3.0, 3.0  # difference from the area beside: in levels, and in its deviation
_GRAIN_PX = 7  # grain is what differs from the mean of a window of so many pixels
_MOST_GRAIN = 4.0  # levels; more counts as this
_CLEAR_PX = 3  # from what is not plain, whose blur is no grain
_REACHED_PX = 5  # from a pixel, by what tells whether it is clear and which grain it has
_WINDOW_PX = 41  # over which the grain of two photographs is compared
_LEAST_SHARE = 0.02  # of such a window that must be plain and seen
_MIN_CORRELATION = (
    0.1  # of grain, in the two sources that correlate best: the sky's is below, walls' 0.2 to 0.6
)
_BEST_SOURCES = 2


def without_rims(reference: StereoView, sources: Sequence[StereoView], inverse_depth: Float32) -> Float32:
    """Return `inverse_depth` (H, W) float32, 0 for none, of `reference` without large plain areas, those with depth
    only if brighter than the photograph's mean, and their rims, whose grain does not correlate in `sources` at that
    depth. What no source sees stays."""
    grey = reference.grey_u8.astype(np.float32)
    deviation = _deviation(grey)
    sky_like = (inverse_depth == 0) | (grey > grey.mean())  # a sky is where the light is from
    area = _large((deviation <= _PLAIN_LEVELS) & sky_like)
    if reference.mask_u8 is not None:
        area &= reference.mask_u8 > 0
    if not area.any() or not inverse_depth.any():
        return inverse_depth
    doubtful = (area | _rim(grey, deviation, area)) & (inverse_depth > 0)
    if not doubtful.any():
        return inverse_depth
    correlation = _grain_correlation(reference, sources, filled(inverse_depth), area, doubtful)
    return np.where(doubtful & (correlation < _MIN_CORRELATION), 0, inverse_depth).astype(np.float32)


def plain_ground(grey_u8: UInt8, depth: Float32) -> Bool:
    """Return (H, W), true in large plain areas without depth, and near them where a photograph (H, W) looks as they do
    and has no `depth` (H, W) float32 either: the sky, or what shows nothing else."""
    grey = grey_u8.astype(np.float32)
    deviation = _deviation(grey)
    area = _large((depth == 0) & (deviation <= _PLAIN_LEVELS))
    return np.asarray(area | (_rim(grey, deviation, area) & (depth == 0)))


def _large(plain: Bool) -> Bool:
    """Return the connected parts of at least `_AREA_PX`."""
    _, labels, facts, _ = cv2.connectedComponentsWithStats(plain.astype(np.uint8), connectivity=4)
    large = facts[:, cv2.CC_STAT_AREA] >= _AREA_PX
    large[0] = False  # what is not plain
    return np.asarray(large[labels])


def _rim(grey: Float32, deviation: Float32, area: Bool) -> Bool:
    """Return the pixels near an area that look like it and are connected with it by others that do."""
    side = 4 * _REACH_PX + 1
    weight = np.maximum(_mean(area.astype(np.float32), side), np.float32(1e-6))
    usual, noise = _mean(grey * area, side) / weight, _mean(deviation * area, side) / weight
    alike = np.abs(grey - usual) <= np.maximum(np.float32(_ALIKE_LEVELS), _ALIKE_NOISE * noise)
    near = cv2.dilate(area.astype(np.uint8), np.ones((2 * _REACH_PX + 1,) * 2, np.uint8)) > 0
    rim = near & alike & ~area
    _, labels = cv2.connectedComponents((rim | area).astype(np.uint8), connectivity=8)
    return np.asarray(rim & np.isin(labels, np.unique(labels[area])))


def _grain_correlation(
    reference: StereoView, sources: Sequence[StereoView], inverse_depth: Float32, area: Bool, where: Bool
) -> Float32:
    """Return (H, W) float32, -1 to 1: the correlation around each pixel, `where` it is asked for, of the grain of an
    area in `reference` and in the sources at `inverse_depth` > 0; 1 where there is none to compare, and elsewhere."""
    result = np.ones(inverse_depth.shape, np.float32)
    grey = reference.grey_u8.astype(np.float32)
    clear, grain = area & _clear(grey), _grain(grey)
    for strip in strips(where.shape, _WINDOW_PX // 2 + _REACHED_PX):
        if where[strip.own].any():
            rows = strip.seen
            by_source = [
                _correlation(reference, source, rows, inverse_depth[rows], clear[rows], grain[rows])[
                    strip.inner
                ]
                for source in sources
            ]
            best = -np.sort(-np.stack(by_source), axis=0)[:_BEST_SOURCES]
            count = np.isfinite(best).sum(axis=0)
            result[strip.own] = np.where(count > 0, np.nansum(best, axis=0) / np.maximum(count, 1), 1)
    return result


def _correlation(
    reference: StereoView,
    source: StereoView,
    rows: slice,
    inverse_depth: Float32,
    clear: Bool,
    grain: Float32,
) -> Float32:
    """Return the correlation with one source of some rows, nan where there is nothing to compare; all but the views are
    of these rows."""
    u, v = (np.arange(side, dtype=np.float32) + np.float32(0.5) for side in reference.size)
    at = project(reference, source, u[None, :], v[rows, None], inverse_depth)
    other = sampled(source, at.x, at.y)
    both = (clear & at.seen & _clear(other)).astype(np.float32)
    own, others = grain * both, _grain(other) * both
    spread = _mean(own * own, _WINDOW_PX) * _mean(others * others, _WINDOW_PX)
    correlation = _mean(own * others, _WINDOW_PX) / np.sqrt(np.maximum(spread, np.float32(1e-9)))
    return np.where(_mean(both, _WINDOW_PX) >= _LEAST_SHARE, correlation, np.nan)


def _grain(grey: Float32) -> Float32:
    return np.asarray(np.clip(grey - _mean(grey, _GRAIN_PX), -_MOST_GRAIN, _MOST_GRAIN), np.float32)


def _clear(grey: Float32) -> Bool:
    """Return where all within `_CLEAR_PX` is plain."""
    plain = (_deviation(grey) <= _PLAIN_LEVELS).astype(np.uint8)
    return np.asarray(cv2.erode(plain, np.ones((2 * _CLEAR_PX + 1,) * 2, np.uint8)) > 0)


def _deviation(grey: Float32) -> Float32:
    mean = _mean(grey, _PLAIN_PX)
    return np.sqrt(np.maximum(_mean(grey * grey, _PLAIN_PX) - mean * mean, 0))


def _mean(image: Float32, side: int) -> Float32:
    return np.asarray(cv2.blur(image, (side, side), borderType=cv2.BORDER_REFLECT_101), np.float32)
